"""What the end of a dialogue pays, and that nothing comes after it."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.simulator import Rewards, Simulator

from .scenes import Scene

WON = {
    "held": {"city": "boston"},
    "history": {"city": "boston", "theater": "odeon"},
    "constraints_met": True,
}


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
