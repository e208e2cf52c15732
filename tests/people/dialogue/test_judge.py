"""Success for people: the rule case by case, and against the simulator's."""

import os
from pathlib import Path

import pytest
import yaml
from oracle.small import small_domain
from study.simulated import Dialogues

from bbq_torchrl.domains import Goal
from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.dialogue.judge import Judge, card

WISHES = {"moviename": "Deadpool", "city": "seattle", "numberofpeople": "2"}
GOAL = Goal(WISHES, ("theater", "date"))
TABLE = yaml.safe_load(Path(__file__).with_name("judge.yaml").read_text(encoding="utf-8"))
SHOWINGS, TALKS = tuple(TABLE["records"]), TABLE["talks"]
DIALOGUES = int(os.environ.get("BBQ_STUDY_DIALOGUES", "100000"))


@pytest.fixture(scope="module")
def judge():
    return Judge(small_domain(GOAL, records=SHOWINGS))


def exchanges(acts):
    """The acts of a person and of the agent, of which one says something."""
    for act in acts:
        said = Frame.parse(act.removeprefix("person: "))
        yield (said, Frame("greeting")) if act.startswith("person") else (Frame("request"), said)


def test_a_card_says_what_is_wished_and_asked_for_in_peoples_words():
    goal = Goal({"city": "reno", "date": "I do NOT care"}, ("theater", "price"))
    shown = card(goal, {"city": "town", "price": "the price"})
    wishes = [("town", "reno"), ("date", "anything")]
    assert shown == {"wishes": wishes, "questions": ["theater", "the price"]}


@pytest.mark.parametrize("case", TALKS, ids=range(len(TALKS)))
def test_a_success_lacks_nothing_and_each_thing_that_is_missing_is_a_reason(judge, case):
    said = [*exchanges(case["acts"])]
    in_time = "out of turns" not in case["reasons"]
    assert judge.reasons(GOAL, said, in_time=in_time) == tuple(case["reasons"])
    if "as_simulated" in case:
        simulated = Judge(small_domain(GOAL, records=SHOWINGS), as_simulated=True)
        assert simulated.reasons(GOAL, said) == tuple(case["as_simulated"])


def test_a_wish_without_preference_is_met_by_any_offer(judge):
    goal = Goal({"moviename": "deadpool", "city": "I do not care"})
    for more in ("", ", city=boston"):
        offer = f"inform(moviename=deadpool{more}, taskcomplete=ticket available)"
        assert not judge.reasons(goal, [*exchanges([offer])])


@pytest.mark.parametrize(
    ("wish", "is_met"), [("in the evening", True), ("before 7", True), ("after 7", False)]
)
def test_a_vague_time_is_met_by_a_time_in_it_but_not_for_simulated_users(wish, is_met):
    goal = Goal({"moviename": "wonka", "date": wish})
    domain = small_domain(goal, records=[{"moviename": "wonka", "date": "6:40 pm"}])
    said = [*exchanges(["inform(moviename=wonka, date=6:40 pm, taskcomplete=ticket available)"])]
    assert Judge(domain).reasons(goal, said) == (() if is_met else ("wishes", "questions"))
    assert "wishes" in Judge(domain, as_simulated=True).reasons(goal, said)


@pytest.mark.parametrize(("time", "is_met"), [("8 pm", True), ("2:35 pm", False)])
def test_a_show_today_at_eight_is_tonight(time, is_met):
    goal = Goal({"moviename": "wonka", "date": "tonight"})
    show = {"moviename": "wonka", "date": "today", "theater": time}
    judge = Judge(small_domain(goal, records=[show]))
    offer = f"inform(moviename=wonka, date=today, theater={time}, taskcomplete=ticket available)"
    assert (judge.reasons(goal, [*exchanges([offer])]) == ()) == is_met


@pytest.mark.parametrize(("told", "reasons"), [(["inform(city=reno)"], ()), ([], ("wishes",))])
def test_what_only_one_of_the_records_booked_has_is_met_once_it_is_said(told, reasons):
    goal = Goal({"moviename": "wonka", "city": "reno"})
    showing = {"moviename": "wonka", "theater": "lux"}
    judge = Judge(small_domain(goal, records=[showing, {**showing, "city": "reno"}]))
    offer = "inform(moviename=wonka, theater=lux, taskcomplete=ticket available)"
    assert judge.reasons(goal, [*exchanges([*told, offer])]) == reasons


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
