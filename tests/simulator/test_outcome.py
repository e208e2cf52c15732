"""When a dialogue ends, how it is judged and what it pays."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.simulator import Rewards, Simulator

from .scenes import ACTS, Scene

WON = {
    "held": {"city": "boston"},
    "history": {"city": "boston", "theater": "odeon"},
    "constraints_met": True,
}


@pytest.mark.parametrize("end", ["thanks", "closing"])
def test_both_ways_to_end_are_judged_alike(end):
    scene = Scene({"city": "boston"}, ("theater",))
    won = scene.say(scene.situation(**WON), end)
    assert won["done"]
    assert won["success"]
    assert won["reward"] == 40
    assert ACTS[int(won["user_act"])] == ACTS[int(won["heard_act"])] == "closing"
    lost = scene.say(scene.situation(**WON | {"constraints_met": False}), end)
    assert lost["done"]
    assert not lost["success"]
    assert lost["reward"] == -10


def test_the_ticket_may_be_left_open():
    scene = Scene({"city": "boston"}, ("theater",))
    state = scene.say(scene.situation(**WON, agenda=("ticket",), pending=("ticket",)), "thanks")
    assert state["success"]


@pytest.mark.parametrize(
    "fault",
    [
        {"agenda": ("theater",)},
        {"pending": ("theater",)},
        {"history": {"ticket": "no match"}},
        {"history": {"genre": "no match"}},
        {"history": {"city": "seattle"}},
        {"user_informs": {"city": "seattle"}},
        {"constraints_met": False},
    ],
)
def test_each_fault_alone_makes_the_end_a_failure(fault):
    scene = Scene({"city": "boston"}, ("theater",))
    assert scene.say(scene.situation(**WON), "thanks")["success"]
    state = scene.say(scene.situation(**WON | fault), "thanks")
    assert state["done"]
    assert not state["success"]


def test_a_constraint_that_never_came_up_is_no_fault():
    scene = Scene({"city": "boston", "date": "today"})
    assert scene.say(scene.situation(**WON), "thanks")["success"]


def test_a_dialogue_that_runs_out_of_turns_fails_even_with_thanks():
    scene = Scene({"city": "boston"}, max_turn=6)
    before = scene.situation(**WON, turn=4, pending=("ticket",), user_informs={"city": "boston"})
    assert scene.say(before, "thanks")["success"]
    late = scene.say(before.clone().set("turn", torch.tensor(6)), "thanks")
    assert late["done"]
    assert not late["success"]
    assert late["reward"] == -10
    assert scene.user(late) == ("closing", {}, {"ticket"})


def test_a_turn_that_does_not_end_the_dialogue_costs_one():
    scene = Scene({"city": "boston"})
    state = scene.say(scene.start(), "greeting")
    assert not state["done"]
    assert state["reward"] == -1
    assert state["turn"] == 2


def test_a_dialogue_that_has_ended_stays_as_it_is():
    scene = Scene({"city": "boston"}, ("theater",), slot_error_prob=0.5)
    ended = scene.say(scene.situation(**WON), "thanks")
    for action in ("inform(theater)", "request(city)", "inform(done)", "thanks", "greeting"):
        later = scene.say(ended, action, error=0.0)
        assert later["reward"] == 0
        for key in ended.keys():  # noqa: SIM118  (a TensorDict iterates over its rows)
            if key != "reward":
                assert (later[key] == ended[key]).all(), (action, key)


def test_no_dialogue_outlasts_its_turns(movie):
    domain = tensorize(movie)
    simulator = Simulator(domain, max_turn=10)
    active = torch.ones(domain.n_slots, dtype=torch.bool)
    state = simulator.reset(simulator.draw_reset((64,)), active)
    greeting = torch.full((64,), movie.action_index("greeting"))
    assert simulator.max_agent_turns == 6
    for turn in range(1, 7):
        assert not state["done"].any()
        state = simulator.turn(state, greeting, simulator.draw_turn((64,)), active)
        assert (state["turn"] == 2 * turn).all()
    assert state["done"].all()
    assert (state["reward"] == -10).all()


def test_rewards_are_what_they_were_set_to():
    scene = Scene({"city": "boston"})
    scene.simulator.rewards = Rewards(success=3.0, failure=-2.0, turn=-0.5)
    assert scene.say(scene.situation(**WON), "thanks")["reward"] == 3
    assert scene.say(scene.start(), "thanks")["reward"] == -2
    assert scene.say(scene.start(), "greeting")["reward"] == -0.5


def test_a_dialogue_must_have_a_turn(movie):
    with pytest.raises(ValueError, match="max_turn must be at least 2, got 1"):
        Simulator(tensorize(movie), max_turn=1)
