"""Success for people: the rule case by case, and against the simulator's."""

from __future__ import annotations

import os

import pytest
from oracle.small import small_domain
from study.simulated import Dialogues

from bbq_torchrl.domains import Goal
from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.dialogue.judge import Judge, card

WISHES = {"moviename": "Deadpool", "city": "seattle", "numberofpeople": "2"}
GOAL = Goal(WISHES, ("theater", "date"))
SHOWINGS = (
    {"moviename": "deadpool", "city": "seattle", "date": "today", "theater": "roxy"},
    {"moviename": "deadpool", "city": "seattle", "date": "friday", "theater": "odeon"},
    {"moviename": "deadpool", "city": "boston", "date": "today", "theater": "odeon"},
    {"moviename": "zootopia", "city": "boston", "theater": "lux", "numberofpeople": "9"},
)
DIALOGUES = int(os.environ.get("BBQ_STUDY_DIALOGUES", "100000"))


@pytest.fixture(scope="module")
def judge():
    return Judge(small_domain(GOAL, records=SHOWINGS))


def told(**informs):
    return (Frame("request"), Frame("inform", informs))


def asked(slot, **informs):
    return (Frame("request"), Frame("request", informs, (slot,)))


def heard(**informs):
    return (Frame("inform", informs), Frame("greeting"))


def offer(taskcomplete="ticket available", **informs):
    return told(taskcomplete=taskcomplete, **informs)


ANSWERS = [told(theater="roxy"), told(date="today")]
WON = [*ANSWERS, offer(**WISHES, theater="roxy", date="today")]


def test_a_card_says_what_is_wished_and_asked_for_in_peoples_words():
    goal = Goal({"city": "reno", "date": "I do NOT care"}, ("theater", "price"))
    shown = card(goal, {"city": "town", "price": "the price"})
    wishes = [("town", "reno"), ("date", "anything")]
    assert shown == {"wishes": wishes, "questions": ["theater", "the price"]}


@pytest.mark.parametrize(
    ("exchanges", "reasons"),
    [
        (WON, ()),
        ([WON[2], *ANSWERS], ()),
        # What had no match counts no more once it has another value.
        ([told(genre="no match"), *WON, heard(genre="I do not care")], ()),
        ([offer("no match", **WISHES), *WON, told(ticket="ticket available")], ()),
        ([], ("no offer", "questions")),
        (ANSWERS, ("no offer",)),
        ([*ANSWERS, offer(**WISHES | {"city": "boston"})], ("wishes",)),
        ([*ANSWERS, offer(moviename="deadpool", city="seattle")], ("wishes",)),
        ([*WON, offer(**WISHES | {"numberofpeople": "3"})], ("wishes",)),
        ([*WON, offer(moviename="deadpool")], ("wishes",)),
        ([*ANSWERS, offer("no match", **WISHES)], ("no ticket", "no match left")),
        ([ANSWERS[0], offer(**WISHES, date="I do not care")], ("questions",)),
        # An answer once given counts.
        ([*ANSWERS, told(date="no match"), offer(**WISHES)], ()),
        ([*ANSWERS, offer(**WISHES, date="I do not care")], ()),
        # The theater that is booked is in the city wished for, whether it was said or not.
        ([*ANSWERS, offer(moviename="Deadpool", theater="roxy", numberofpeople="2")], ()),
        ([*ANSWERS, offer(**WISHES | {"city": "I do not care"}, theater="roxy")], ()),
        ([*ANSWERS, offer(**WISHES | {"city": "I do not care"}, theater="odeon")], ("wishes",)),
        ([*ANSWERS, offer(moviename="Deadpool", theater="roxy")], ("wishes",)),  # for how many?
        ([told(theater="odeon"), told(date="today"), offer(**WISHES)], ("questions",)),
        ([told(theater="lux"), told(date="today"), offer(**WISHES)], ("questions",)),
        ([told(date="no match"), offer(**WISHES)], ("questions", "no match left")),
        # An answer may stand in the offer, or before a question.
        ([told(theater="odeon"), told(date="no match"), WON[2]], ()),
        ([asked("city", theater="roxy", date="today"), offer(**WISHES)], ()),
        ([heard(theater="roxy"), told(date="today"), offer(**WISHES)], ("questions",)),
        # Who has got the card is not failed for what else had no match.
        ([*ANSWERS, told(genre="no match"), WON[2]], ()),
        ([offer("no match", **WISHES), *WON], ()),
    ],
)
def test_a_success_lacks_nothing_and_each_thing_that_is_missing_is_a_reason(
    judge, exchanges, reasons
):
    assert judge.reasons(GOAL, exchanges) == reasons


@pytest.mark.parametrize("more", [told(genre="no match"), offer("no match", **WISHES)])
def test_the_simulator_leaves_nothing_without_a_match(more):
    judge = Judge(small_domain(GOAL, records=SHOWINGS), as_simulated=True)
    assert judge.reasons(GOAL, [more, *WON]) == ("no match left",)


def test_running_out_of_turns_is_no_success(judge):
    assert judge.reasons(GOAL, WON, in_time=False) == ("out of turns",)


def test_a_wish_without_preference_is_met_by_any_offer():
    goal = Goal({"moviename": "deadpool", "city": "I do not care"})
    judge = Judge(small_domain(goal, records=SHOWINGS))
    for more in ({}, {"city": "boston"}):
        assert not judge.reasons(goal, [offer(moviename="deadpool", **more)])


def test_goals_are_attainable_where_one_record_has_it_all(judge):
    assert judge.is_attainable(GOAL)
    assert not judge.is_attainable(Goal({"moviename": "deadpool", "city": "austin"}))
    assert not judge.is_attainable(Goal({"moviename": "zootopia"}, ("date",)))
    assert judge.is_attainable(Goal({"moviename": "zootopia", "numberofpeople": "77"}))


PLAYED = [
    ("careful", {"random_share": 0.3, "booking_share": 0.5}),
    ("careful", {"random_share": 0.0, "booking_share": 0.0}),
    ("careful", {"random_share": 0.1, "booking_share": 0.0}),
    ("rule", {"random_share": 0.1, "booking_share": 0.0}),
    ("rule_inform", {"random_share": 0.3, "booking_share": 0.5}),
]


@pytest.mark.parametrize(
    ("dialogues", "played"),
    [(100, PLAYED[:1]), pytest.param(DIALOGUES // len(PLAYED), PLAYED, marks=pytest.mark.slow)],
)
def test_without_errors_the_rule_is_the_simulators(movie, dialogues, played):
    judge, batch = Judge(movie, as_simulated=True), min(dialogues, 2_000)
    for policy, shares in played:
        outcomes = []
        while len(outcomes) < dialogues:
            simulated = Dialogues(movie, batch, policy, **shares, seed=len(outcomes))
            for goal, exchanges, in_time, success in simulated.conversations():
                reasons = judge.reasons(goal, exchanges, in_time=in_time)
                assert (not reasons) == success, (goal, exchanges, reasons)
                outcomes.append(success)
        assert set(outcomes) == {True, False}
