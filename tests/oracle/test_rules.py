"""The oracle's user against dialogues worked out by hand from the rules, one rule a test."""

from __future__ import annotations

import pytest

from .draws import choose_index, choose_slot
from .small import GOAL, say, start


def test_a_choice_among_slots_falls_on_the_largest_number_and_on_the_first_of_equals():
    u = [0.9, 0.5, 0.5, 0.1]
    assert choose_slot({"b", "c", "d"}, u, ["a", "b", "c", "d"]) == "b"
    assert choose_slot({"c", "d"}, u, ["a", "b", "c", "d"]) == "c"
    assert [choose_index(u, 4) for u in (0.0, 0.24, 0.25, 0.99)] == [0, 0, 1, 3]


def test_a_whole_dialogue_that_succeeds():
    dialogue = start(GOAL, ("theater",), first={"constraint": "city"})
    user, tracker = dialogue.user, dialogue.tracker
    assert (user.act, user.informs) == ("request", {"moviename": "deadpool", "city": "seattle"})
    assert user.pending == {"theater"}
    assert user.agenda == {"numberofpeople", "theater", "ticket"}

    say(dialogue, "request(numberofpeople)")
    assert (user.act, user.informs, user.pending) == ("inform", {"numberofpeople": "2"}, set())

    say(dialogue, "inform(theater)")  # two of the three matching rows are at the Odeon
    assert tracker.agent_informs == {"theater": "odeon"}
    assert (user.act, user.informs, user.pending) == ("request", {}, {"ticket"})

    say(dialogue, "inform(taskcomplete)")
    assert tracker.agent_informs == {
        "moviename": "deadpool",
        "city": "seattle",
        "numberofpeople": "2",
        "theater": "odeon",
        "taskcomplete": "ticket available",
    }
    assert (user.act, user.constraints_met, user.pending) == ("thanks", True, {"ticket"})
    assert (dialogue.done, dialogue.reward) == (False, -1.0)

    say(dialogue, "thanks")
    assert (dialogue.done, dialogue.success, dialogue.reward) == (True, True, 40.0)
    assert (user.act, dialogue.turn_count) == ("closing", 8)


@pytest.mark.parametrize(
    ("constraints", "requests", "informs", "pending"),
    [
        (GOAL, ("theater", "date"), {"moviename", "city"}, {"date"}),
        ({"moviename": "deadpool"}, (), {"moviename"}, {"ticket"}),
        ({"date": "today"}, ("moviename",), {"date"}, {"moviename"}),
        ({}, ("moviename", "theater"), set(), {"moviename"}),
    ],
)
def test_the_first_turn_informs_the_movie_and_one_constraint_and_requests_one_slot(
    constraints, requests, informs, pending
):
    chosen = {"constraint": "city", "request": {"date": 0.9, "theater": 0.1, "moviename": 0.2}}
    user = start(constraints, requests, first=chosen).user
    assert (set(user.informs), user.pending) == (informs, pending)
    assert user.agenda == (set(constraints) - informs) | set(requests) | {"ticket"}
    assert user.act == "request"


def test_a_request_for_a_constraint_is_answered_and_clears_what_the_user_asked():
    user = (dialogue := start(GOAL, ("theater",), first={"constraint": "city"})).user
    say(dialogue, "request(moviename)")
    assert (user.act, user.informs) == ("inform", {"moviename": "deadpool"})
    assert user.pending == set()
    assert user.agenda == {"numberofpeople", "theater", "ticket"}


def test_a_request_for_what_the_user_wants_to_know_comes_back_with_all_open_constraints():
    user = (dialogue := start(GOAL, ("theater", "date"), first={"request": "date"})).user
    say(dialogue, "request(theater)")
    assert user.act == "request"
    assert user.informs == {"city": "seattle", "numberofpeople": "2"}
    assert user.pending == {"date", "theater"}
    assert user.agenda == {"date", "theater", "ticket"}


def test_a_request_for_an_answered_request_is_answered_from_history():
    user = (dialogue := start(GOAL, ("theater", "date"), first={"request": "date"})).user
    say(dialogue, "inform(theater)", "request(theater)")
    assert user.history["theater"] == "odeon"
    assert (user.act, user.informs, user.pending) == ("inform", {"theater": "odeon"}, set())


def test_a_request_of_no_interest_leaves_what_the_user_asked_and_ends_in_thanks_when_nothing_is():
    user = (dialogue := start({"moviename": "deadpool"}, ("theater",))).user
    say(dialogue, "request(genre)")
    assert (user.act, user.informs) == ("inform", {"genre": "i do not care"})
    assert user.pending == {"theater"}
    say(dialogue, "inform(theater)", "inform(ticket)", "request(genre)")
    assert (user.agenda, user.pending) == (set(), set())
    assert (user.act, user.informs) == ("thanks", {"genre": "i do not care"})


def test_a_wrong_inform_is_corrected_and_what_the_user_asked_stays():
    goal = GOAL | {"city": "boston"}
    dialogue = start(goal, ("theater",), first={"constraint": "moviename"})
    user, tracker = dialogue.user, dialogue.tracker
    say(dialogue, "inform(city)")
    assert tracker.agent_informs == {"city": "seattle"}
    assert (user.act, user.informs, user.pending) == ("inform", {"city": "boston"}, {"theater"})
    assert user.history["city"] == "seattle"
    assert tracker.held["city"] == "boston"
    say(dialogue, "greeting")
    assert user.history["city"] == "boston"


@pytest.mark.parametrize(
    ("requests", "before", "agenda", "act", "informs", "pending"),
    [
        # A right inform (of the movie): a pending request, an agenda slot, the ticket, thanks.
        (("theater",), (), "city", "request", {}, {"theater"}),
        ((), ("request(moviename)",), "city", "inform", {"city"}, set()),
        (("date",), ("request(moviename)",), "date", "request", {}, {"date"}),
        (
            (),
            ("request(moviename)", "request(city)", "request(numberofpeople)"),
            "city",
            "request",
            {},
            {"ticket"},
        ),
        (
            (),
            ("inform(ticket)", "request(city)", "request(numberofpeople)"),
            "city",
            "thanks",
            {},
            set(),
        ),
    ],
)
def test_a_right_inform_lets_the_user_go_on(requests, before, agenda, act, informs, pending):
    dialogue = start(GOAL, requests)
    say(dialogue, *before)
    say(dialogue, "inform(moviename)", agenda=agenda)
    user = dialogue.user
    assert (user.act, set(user.informs), user.pending) == (act, set(informs), pending)
    assert not set(user.informs) & user.agenda
    assert user.pending <= user.agenda


@pytest.mark.parametrize(
    ("requests", "before", "agenda", "act", "informs", "pending"),
    [
        # An inform of the genre, which the goal does not name.
        (("theater",), (), "city", "request", {}, {"theater"}),
        ((), ("request(moviename)",), "city", "request", {"city"}, {"ticket"}),
        (("date",), ("request(moviename)",), "date", "request", {}, {"date"}),
        ((), ("inform(ticket)", "request(city)"), "city", "inform", {"numberofpeople"}, set()),
        (
            (),
            ("request(city)", "request(numberofpeople)"),
            "city",
            "request",
            {},
            {"ticket"},
        ),
        (
            (),
            ("inform(ticket)", "request(city)", "request(numberofpeople)"),
            "city",
            "thanks",
            {},
            set(),
        ),
    ],
)
def test_an_inform_beside_the_constraints_lets_the_user_go_on_and_brings_the_ticket_along(
    requests, before, agenda, act, informs, pending
):
    dialogue = start(GOAL, requests)
    say(dialogue, *before)
    say(dialogue, "inform(genre)", agenda=agenda)
    user = dialogue.user
    assert (user.act, set(user.informs), user.pending) == (act, set(informs), pending)


def test_an_inform_answers_a_request_of_the_user():
    user = (dialogue := start(GOAL, ("theater",))).user
    say(dialogue, "inform(theater)", agenda="city")
    assert user.agenda == {"numberofpeople", "ticket"}
    assert user.pending == {"ticket"}
    assert (user.act, user.informs) == ("request", {"city": "seattle"})


def test_an_offer_that_lacks_a_constraint_is_denied():
    user = (dialogue := start(GOAL, ("theater",), first={"constraint": "city"})).user
    say(dialogue, "inform(taskcomplete)")
    assert (user.act, user.constraints_met, user.pending) == ("deny", False, set())
    assert "taskcomplete" not in user.history


@pytest.mark.parametrize(("people", "verdict"), [((), "deny"), (("numberofpeople",), "thanks")])
def test_an_offer_without_a_match_is_remembered_whatever_the_verdict(people, verdict):
    goal = {"moviename": "zootopia", "city": "seattle", "numberofpeople": "2"}
    user = (dialogue := start(goal, (), first={"constraint": "city"})).user
    assert user.pending == {"ticket"}
    say(dialogue, *(f"request({slot})" for slot in people))
    say(dialogue, "inform(taskcomplete)")
    assert user.act == verdict
    assert user.history["ticket"] == "no match"
    assert "ticket" not in user.agenda | user.pending
    say(dialogue, "thanks")
    assert (dialogue.success, dialogue.reward) == (False, -10.0)


def test_the_verdict_on_an_offer_holds_while_requests_are_answered_after_it():
    user = (dialogue := start(GOAL, ("theater",), first={"constraint": "city"})).user
    say(dialogue, "request(numberofpeople)", "inform(taskcomplete)")
    assert (user.act, user.constraints_met) == ("thanks", True)
    say(dialogue, "inform(theater)", "thanks")
    assert (user.constraints_met, dialogue.success) == (True, True)


def test_confirm_answer_draws_from_the_whole_agenda():
    user = (dialogue := start(GOAL, ("theater",))).user
    say(dialogue, "confirm_answer", agenda="numberofpeople")
    assert (user.act, user.informs) == ("inform", {"numberofpeople": "2"})
    say(dialogue, "confirm_answer", agenda="ticket")
    assert (user.act, user.informs, user.pending) == ("request", {}, {"theater", "ticket"})
    say(dialogue, "inform(theater)", "inform(ticket)", "inform(city)", "confirm_answer")
    assert (user.act, user.agenda) == ("thanks", set())


@pytest.mark.parametrize("act", ["greeting", "deny", "confirm_question"])
def test_small_talk_makes_the_user_repeat_its_act_with_nothing_informed(act):
    user = (dialogue := start(GOAL, ("theater",))).user
    say(dialogue, "request(date)", act)
    assert (user.act, user.informs, user.pending) == ("inform", {}, {"theater"})


def test_a_choice_is_answered_by_the_constraint_or_by_one_of_those_offered():
    user = (dialogue := start(GOAL, ("theater",))).user
    say(dialogue, "multiple_choice(city)")
    assert (user.act, user.informs) == ("inform", {"city": "seattle"})
    assert "city" not in user.agenda
    say(dialogue, "multiple_choice(theater)", offer=0.5)  # of Roxy and Odeon, in this order
    assert (user.act, user.informs) == ("inform", {"theater": "odeon"})
    say(dialogue, "multiple_choice(theater)")
    assert user.informs == {"theater": "odeon"}  # the Odeon is held by now
    dialogue = start({"moviename": "zootopia"}, ("theater",))
    say(dialogue, "multiple_choice(theater)")
    assert dialogue.user.informs == {"theater": "i do not care"}


def test_the_dialogue_is_lost_on_the_act_that_comes_too_late_even_if_it_is_thanks():
    dialogue = start(GOAL, (), first={"constraint": "city"}, max_turn=6)
    say(dialogue, "request(numberofpeople)", "inform(taskcomplete)", "greeting")
    assert not dialogue.done
    say(dialogue, "thanks")
    assert (dialogue.done, dialogue.success, dialogue.reward) == (True, False, -10.0)
    assert dialogue.user.act == "closing"
    assert dialogue.tracker.agent_act == "thanks"


@pytest.mark.parametrize("end", ["thanks", "closing"])
def test_thanks_and_closing_are_judged_alike(end):
    dialogue = start(GOAL, (), first={"constraint": "city"})
    say(dialogue, "request(numberofpeople)", "inform(taskcomplete)", end)
    assert dialogue.success


@pytest.mark.parametrize(
    ("before", "fault"),
    [
        (("request(numberofpeople)", "inform(theater)"), "constraints not met"),
        (
            ("inform(theater)", "request(numberofpeople)", "inform(taskcomplete)", "inform(genre)"),
            "no match in history",
        ),
        (("request(numberofpeople)", "inform(taskcomplete)"), "an agenda"),
    ],
)
def test_each_fault_alone_makes_the_end_a_failure(before, fault):
    dialogue = start(GOAL, ("theater",), first={"constraint": "city"})
    say(dialogue, *before)
    dialogue.user.remember_last_act()
    assert fault in dialogue.user.faults()
    say(dialogue, "thanks")
    assert not dialogue.success


def test_a_wrong_value_in_history_fails_unless_the_agent_asks_again():
    setting = {"slot_error_prob": 0.05, "slot_error_mode": "value"}
    hit = {"error": {"numberofpeople": 0.0, "city": 0.0}, "error_value": {"city": 0.6}}
    goal = {"moviename": "deadpool", "city": "seattle"}
    dialogue = start(goal, (), first={"constraint": "moviename"}, **setting)
    say(dialogue, "request(city)", **hit)
    assert dialogue.user.informs == {"city": "boston"} == {"city": dialogue.tracker.held["city"]}
    say(dialogue, "inform(taskcomplete)")
    assert (dialogue.user.act, dialogue.user.faults()) == (
        "deny",
        ["constraints not met", "a wrong value in history"],
    )
    say(dialogue, "request(city)", "inform(taskcomplete)", "thanks")
    assert dialogue.success
