"""The oracle's errors against dialogues worked out by hand, one rule a test."""

from __future__ import annotations

import pytest

from .small import GOAL, say, start


def test_value_errors_draw_from_the_slots_list_and_spare_slots_without_one():
    setting = {"slot_error_prob": 1.0, "slot_error_mode": "value"}
    dialogue = start(GOAL | {"date": "today"}, ("theater",), **setting)
    assert dialogue.tracker.held["moviename"] == "deadpool"  # no error in the first turn
    say(dialogue, "request(theater)", error=0.0, error_value={"date": 0.99, "city": 0.5})
    assert dialogue.user.informs == {"city": "boston", "date": "friday", "numberofpeople": "2"}
    assert dialogue.tracker.user_requests == {"theater"}


def test_slot_errors_go_to_another_active_slot_with_values_and_later_slots_win():
    setting = {"slot_error_prob": 0.5, "slot_error_mode": "slot"}
    goal = GOAL | {"date": "today"}
    dialogue = start(goal, ("theater",), first={"constraint": "moviename"}, **setting)
    # city -> date = today or so, date -> city = boston: each takes the other's place.
    say(
        dialogue,
        "request(theater)",
        error={"city": 0.0, "date": 0.4},
        error_slot={"city": 0.99, "date": 0.99},
        error_value={"city": 0.34, "date": 0.99},
    )
    assert dialogue.user.informs == {"date": "tomorrow", "city": "boston", "numberofpeople": "2"}
    setting["active"] = {"city", "date", "ticket", "taskcomplete", "theater"}
    dialogue = start(goal, ("theater",), first={"constraint": "date"}, **setting)
    say(dialogue, "request(theater)", error={"city": 0.0})  # the only other active list is date's
    assert dialogue.user.informs == {"date": "today"}
    setting["active"] = {"city", "ticket", "taskcomplete", "theater"}
    dialogue = start(goal, ("theater",), first={"constraint": "city"}, **setting)
    say(dialogue, "request(city)", error={"city": 0.0})  # no other list: deleted
    assert dialogue.user.informs == {}


def test_an_original_that_was_not_hit_gives_way_to_a_replacement():
    setting = {"slot_error_prob": 0.5, "slot_error_mode": "slot"}
    dialogue = start(GOAL | {"date": "today"}, ("theater",), **setting)
    say(
        dialogue,
        "request(theater)",
        error={"city": 0.0},
        error_slot={"city": 0.99},
        error_value={"city": 0.99},
    )
    assert dialogue.user.informs == {"date": "friday", "numberofpeople": "2"}


@pytest.mark.parametrize(
    ("kind", "informs"),
    [(0.33, {"city": "boston"}), (0.34, {"moviename": "zootopia"}), (0.67, {})],
)
def test_mixed_errors_are_one_third_each(kind, informs):
    setting = {"slot_error_prob": 1.0, "slot_error_mode": "mixed"}
    dialogue = start(GOAL, (), **setting)
    say(dialogue, "request(city)", error=0.0, error_kind=kind, error_value=0.9)
    assert dialogue.user.informs == informs


def test_an_intent_error_changes_what_is_heard_and_not_what_the_user_repeats():
    dialogue = start(GOAL, ("theater",), intent_error_prob=0.5)
    say(dialogue, "request(date)", intent=0.49, intent_act=0.999)
    assert (dialogue.user.act, dialogue.tracker.heard_act) == ("inform", "deny")
    say(dialogue, "greeting")
    assert dialogue.tracker.heard_act == "inform"
