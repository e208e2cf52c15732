"""The tensor simulator agrees with the oracle, turn by turn and number by number."""

from collections import Counter
from dataclasses import replace
from itertools import combinations

import pytest
import torch

from bbq_torchrl.domains import Goal, load_miulab
from bbq_torchrl.simulator import Profile
from bbq_torchrl.simulator.profiles import MIXES

from .agreement import Comparison
from .dialogue import Setting
from .rules import rules_at_work
from .small import small_domain

SETTINGS = (
    Setting(),
    Setting(slot_error_prob=0.15),
    Setting(slot_error_prob=0.25, slot_error_mode="value", intent_error_prob=0.1),
    Setting(slot_error_prob=0.5, slot_error_mode="slot"),
    Setting(slot_error_prob=0.25, slot_error_mode="delete", max_turn=60),
    Setting(slot_error_prob=0.3, slot_error_mode="mixed", intent_error_prob=0.3, max_turn=17),
    Setting(slot_error_prob=0.15, extension=0),
    Setting(slot_error_prob=0.3, slot_error_mode="slot", extension=0),
    Setting(slot_error_prob=0.3, slot_error_mode="mixed", extension=4),
)
ANY = {"insists": 0.5, "asks_late": 0.5, "confirms": 0.5, "withholds": 0.5, "explains": 0.5}
PEOPLE = (
    Profile(0.2),
    Profile(0.5, (5, 20), None, (1, 3), changes_mind=0.7, **ANY),
    Profile(0.3, None, (1, 6), (2, 9), **ANY, slot_error_prob={"date": 0.6, "moviename": 0.0}),
)
USERS = (
    Setting(users=PEOPLE),
    Setting(users=(Profile(asks_late=1.0, explains=0.5),)),
    Setting(users=MIXES["people"], slot_error_prob=0.15, intent_error_prob=0.1),
    Setting(users=PEOPLE, slot_error_prob=0.3, slot_error_mode="mixed", extension=4, max_turn=23),
)
"""Settings with users that differ."""

FEW = SETTINGS[2::3]
"""Settings with errors in slots and acts, a short dialogue, and domain extension."""

ENOUGH = 10
"""The least number of times that each rule must apply for a meaningful agreement."""

RARE_RULES = {
    "open: no constraint",
    "choice: a constraint",
    "choice: one of those offered",
    "choice: nothing offered",
    "error: value, but no list",
    "error: slot, but no other",
}
"""Rules that apply only in other domains."""

RULES = rules_at_work() - RARE_RULES
"""Rules of the user, the errors and the tracker that apply in the movie domain."""

PERSON_RULES = {
    "end: out of patience",
    "person: keeps its questions",
    "person: yes to a value",
    "person: yes to a question",
    "person: changes its mind",
    "person: denies a value",
    "person: explains",
    "person: asks again",
    "person: is passed over",
    "person: asks after the offer",
    "person: thanks after the last answer",
    "person: tells less",
    "person: tells more",
}
"""The ways in which users differ from the agenda-based user."""

BOOKS = {"offer: thanks, available"}


def test_the_simulator_agrees_with_the_oracle_on_our_movies(movie):
    assert_at_work(RULES, play(movie, 160, seed=0))


@pytest.mark.slow
def test_the_simulator_agrees_with_the_oracle_on_the_public_corpus(miulab, tcbot):
    assert_at_work(BOOKS, play(miulab, 60, seed=100, settings=FEW))
    first = load_miulab(tcbot, goals="user_goals_first_turn_template.part.movie.v1.p")
    assert_at_work(BOOKS, play(first, 40, seed=200, settings=FEW))


def test_the_simulator_agrees_with_the_oracle_where_goals_and_errors_are_odd():
    assert_at_work(RARE_RULES, play(many_wishes(), 80, seed=400))


def test_the_simulator_agrees_with_the_oracle_on_users_that_differ(movie):
    assert_at_work(PERSON_RULES, play(movie, 90, seed=800, settings=USERS))


@pytest.mark.slow
def test_the_simulator_agrees_with_the_oracle_in_other_domains(movie, restaurant):
    assert_at_work(BOOKS, play(restaurant, 40, seed=300))
    several = replace(movie, opening_slots=("date", "moviename", "city"))
    assert_at_work({"open: the opening slot"}, play(several, 40, seed=600, settings=FEW))
    none = replace(restaurant, opening_slots=())
    assert play(none, 20, seed=700, settings=FEW)["open: the opening slot"] == 0
    assert_at_work(BOOKS, play(many_wishes(), 60, seed=900, settings=USERS))
    few = [replace(setting, users=MIXES["mixed"]) for setting in FEW]
    assert_at_work(BOOKS, play(restaurant, 40, seed=950, settings=few))


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device, BBQ_TEST_CUDA=1")
def test_the_simulator_agrees_with_the_oracle_on_an_accelerator(movie):
    assert_at_work(BOOKS, play(movie, 200, seed=500, device="cuda"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1000, 2000])
def test_the_simulator_agrees_with_the_oracle_over_many_dialogues(movie, miulab, seed):
    for domain in (movie, miulab):
        assert_at_work(RULES, play(domain, 1_000, seed))


def play(domain, dialogues, seed, device="cpu", settings=SETTINGS):
    played = Counter()
    for number, setting in enumerate(settings):
        played += Comparison(domain, setting, dialogues, seed + number, device).play()
    return played


def assert_at_work(rules, played):
    idle = {rule: played[rule] for rule in rules if played[rule] < ENOUGH}
    assert not idle, f"rules seen fewer than {ENOUGH} times: {idle}"
    assert played["successes"] > played["dialogues"] / 20


def many_wishes():
    """Returns the small cinema with all combinations of wishes, even none and unmeetable ones."""
    wishes = {"moviename": "deadpool", "city": "boston", "date": "today", "numberofpeople": "2"}
    questions = ("theater", "genre")
    goals = [
        Goal({slot: wishes[slot] for slot in chosen}, questions[:asked])
        for size in range(len(wishes) + 1)
        for chosen in combinations(wishes, size)
        for asked in range(len(questions) + 1)
    ]
    indifferent = Goal({"moviename": "zootopia", "city": "I do not care"}, ("genre",))
    unheard_of = Goal({"theater": "Palace", "city": "Seattle"}, ("moviename",))
    return small_domain(*goals, indifferent, unheard_of)
