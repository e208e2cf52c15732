"""How the tracker completes the agent's acts and what it remembers."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.simulator import Simulator

from .scenes import ACTIONS, ACTS, Scene, cinema


def test_the_latest_value_wins_whichever_side_it_came_from():
    scene = Scene({"city": "boston"})
    before = scene.situation(held={"city": "seattle"}, agenda=("ticket",))
    heard = scene.say(before, "request(city)")
    assert scene.values(heard["held"]) == {"city": "boston"}
    told = scene.say(heard, "inform(theater)")
    assert scene.values(told["held"]) == {"city": "boston", "theater": "odeon"}


def test_an_inform_is_filled_from_what_matches_all_that_is_held_its_own_slot_too():
    scene = Scene({"city": "boston"}, ("theater",))
    before = scene.situation(held={"theater": "lux", "city": "boston"}, pending=("theater",))
    state = scene.say(before, "inform(theater)")
    assert scene.values(state["agent_informs"]) == {"theater": "lux"}


def test_no_match_is_held_and_spoils_look_ups_until_the_user_corrects_it():
    scene = Scene({"date": "today"}, ("theater",))
    before = scene.situation(held={"theater": "lux"}, agenda=("ticket",), pending=("ticket",))
    state = scene.say(before, "inform(date)")
    assert scene.values(state["agent_informs"]) == {"date": "no match"}
    assert scene.values(state["held"]) == {"theater": "lux", "date": "today"}

    state = scene.say(before, "inform(genre)", "inform(city)")
    assert scene.values(state["agent_informs"]) == {"city": "no match"}


@pytest.mark.parametrize(
    ("held", "answer"),
    [({"city": "boston"}, "ticket available"), ({"genre": "no match"}, "no match")],
)
def test_a_ticket_is_available_where_a_record_matches(held, answer):
    scene = Scene({})
    state = scene.say(scene.situation(held=held), "inform(ticket)")
    assert scene.values(state["agent_informs"]) == {"ticket": answer}
    assert scene.values(state["held"])["ticket"] == answer
    # A ticket that is held never constrains the records.
    again = scene.say(state, "inform(ticket)")
    assert scene.values(again["agent_informs"]) == {"ticket": answer}


def test_a_booking_offers_all_values_held_before_it():
    scene = Scene({"people": "9"})
    before = scene.situation(held={"city": "boston", "people": "9"})
    state = scene.say(before, "inform(done)")
    offer = {"city": "boston", "people": "9", "done": "ticket available"}
    assert scene.values(state["agent_informs"]) == offer
    assert scene.values(state["held"]) == offer


def test_requests_and_small_talk_inform_nothing():
    scene = Scene({"city": "boston"})
    before = scene.situation(held={"city": "boston"})
    state = scene.say(before, "request(date)")
    assert scene.slots(state["agent_requests"]) == {"date"}
    assert scene.values(state["agent_informs"]) == {}
    state = scene.say(state, "greeting")
    assert scene.slots(state["agent_requests"]) == set()
    assert ACTS[int(state["agent_act"])] == "greeting"


def test_a_multiple_choice_is_held_by_nobody():
    scene = Scene({"city": "boston"}, slot_error_prob=1.0, slot_error_mode="delete")
    before = scene.situation(held={"city": "boston"})
    state = scene.say(before, "multiple_choice(theater)", error=0.0)
    assert scene.values(state["agent_informs"]) == {"theater": "ticket available"}
    assert scene.values(state["held"]) == {"city": "boston"}
    state = scene.say(scene.situation(held={"genre": "no match"}), "multiple_choice(theater)")
    assert scene.values(state["agent_informs"]) == {"theater": "no match"}


def test_only_domains_with_multiple_choices_have_values_to_choose_from(movie):
    domain = tensorize(movie)
    tracker = Simulator(domain).tracker
    agent = tracker.complete(torch.zeros(domain.n_slots, dtype=torch.long), torch.tensor(0))
    with pytest.raises(ValueError, match="no action of kind 'multiple_choice'"):
        agent.choose(torch.tensor(0.5))


def test_the_tracker_knows_every_action_by_its_kind():
    domain = tensorize(cinema(Goal({})))
    tracker = Simulator(domain).tracker
    actions = torch.arange(len(ACTIONS))
    agent = tracker.complete(torch.zeros(len(ACTIONS), domain.n_slots, dtype=torch.long), actions)

    def named(flags):
        return {name for name, flag in zip(ACTIONS, flags.tolist(), strict=True) if flag}

    assert named(agent.is_request) == {name for name in ACTIONS if name.startswith("request(")}
    informs = {name for name in ACTIONS if name.startswith("inform(")}
    assert named(agent.is_inform) == informs - {"inform(done)"}
    assert named(agent.is_booking) == {"inform(done)"}
    assert named(agent.is_multiple_choice) == {"multiple_choice(theater)"}
    assert named(agent.is_confirm_answer) == {"confirm_answer"}
    assert named(agent.is_end) == {"thanks", "closing"}
