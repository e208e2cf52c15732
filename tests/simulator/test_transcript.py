"""Dialogues as people read them."""

from __future__ import annotations

import pytest

from bbq_torchrl.simulator import Transcript

from .scenes import ACTS, NEVER, Scene


@pytest.fixture
def scene():
    return Scene(
        {"city": "boston", "date": "today"},
        ("theater",),
        slot_error_prob=0.5,
        intent_error_prob=0.5,
    )


def test_a_dialogue_reads_as_acts_with_slots_and_values(scene):
    transcript = Transcript(scene.domain)
    state = scene.start(constraint="city")
    assert transcript.goal(state) == "request(theater, ticket) inform(city=boston, date=today)"
    assert transcript.lines(state) == ["user: request(theater) inform(city=boston)"]
    state = scene.say(state, "request(date)")
    assert transcript.lines(state) == ["agent: request(date)", "user: inform(date=today)"]
    state = scene.say(state, "inform(done)")
    assert transcript.lines(state) == [
        "agent: inform(city=boston, date=today, done=ticket available)",
        "user: thanks",
    ]
    state = scene.say(state, "inform(theater)")
    assert transcript.lines(state) == ["agent: inform(theater=odeon)", "user: request(ticket)"]
    state = scene.say(state, "thanks")
    assert transcript.lines(state) == ["agent: thanks", "user: closing request(ticket)"]


def test_the_act_comes_before_what_belongs_to_another(scene):
    transcript = Transcript(scene.domain)
    before = scene.situation(
        agenda=("city", "ticket"), pending=("theater",), held={"date": "friday"}
    )
    state = scene.say(before, "inform(city)")
    assert transcript.user(state) == "inform(city=boston) request(theater)"
    assert transcript.user(scene.say(state, "greeting")) == "inform request(theater)"


def test_what_was_misheard_is_shown_beside_what_was_meant(scene):
    transcript = Transcript(scene.domain)
    before = scene.situation(agenda=("city", "ticket"))
    deny = ACTS.index("deny") / len(ACTS) + 0.01
    state = scene.say(
        before, "request(city)", error=0.0, error_value=NEVER, intent=0.0, intent_act=deny
    )
    assert transcript.user(state) == "inform(city=boston) [heard: deny inform(city=austin)]"


def test_a_transcript_is_of_one_dialogue(scene):
    state = scene.start()
    several = state.unsqueeze(0).expand(3)
    transcript = Transcript(scene.domain)
    assert transcript.lines(several[1]) == transcript.lines(state)
    with pytest.raises(ValueError, match=r"must have batch size \[\], got \[3\]"):
        transcript.lines(several)
