"""The shipped hotels and restaurants: consistent, small, and as hard as the movies."""

import runpy
from pathlib import Path

import pytest
from tiny import nightly

from bbq_torchrl.cli.evaluate import composed, evaluation
from bbq_torchrl.domains import fold, load_miulab, shipped_domain
from bbq_torchrl.domains.folder import GOALS_FILE, RECORDS_FILE, SHIPPED, VALUES_FILE
from bbq_torchrl.envs import ExtensionSchedule

NAMES = ("hotel", "restaurant")


def success(name, policy, *overrides):
    """The success rate of a policy, and its standard error."""
    played = evaluation(composed([f"policy={policy}", f"domain={name}", *overrides]))
    return played["success_rate"], played["standard_error"]


def records_for(domain, goal):
    """The records that meet all that the goal constrains."""
    wanted = {s: fold(v) for s, v in goal.constraints.items() if s not in domain.free_slots}
    folded = ({slot: fold(value) for slot, value in row.items()} for row in domain.records)
    return [row for row in folded if wanted.items() <= row.items()]


@pytest.mark.parametrize("name", NAMES)
def test_a_record_meets_every_goal_and_the_extension_adds_every_slot(name):
    domain = shipped_domain(name)
    assert 30 <= len(domain.records) <= 100
    for goal in domain.goals:
        assert any({*goal.requests} <= row.keys() for row in records_for(domain, goal)), goal
    assert not ExtensionSchedule().never_active(domain)


@pytest.mark.parametrize("name", nightly(NAMES, ["hotel"]))
def test_a_domain_is_as_hard_for_the_rule_as_the_movies(name):
    rate, error = success(name, "rule")
    assert abs(rate - 0.183) < 0.005 + 3 * error


@pytest.mark.parametrize("name", nightly(NAMES, ["hotel"]))
def test_policies_that_know_more_succeed_more_often(name):
    order = ("random", "rule", "careful", "repair", "clairvoyant")
    rates = [success(name, policy, "dialogues=500")[0] for policy in order]
    assert rates == sorted(rates)
    assert rates[0] < 0.05
    assert rates[-1] > 0.98


SCRIPT = Path(__file__).parents[2] / "scripts" / "make_movie_corpus.py"


@pytest.mark.slow
def test_the_shipped_files_are_what_the_script_writes(tmp_path):
    runpy.run_path(str(SCRIPT))["write_corpus"](tmp_path)
    for name in (RECORDS_FILE, GOALS_FILE, VALUES_FILE):
        assert (tmp_path / name).read_bytes() == (SHIPPED["movie"] / name).read_bytes(), name


def test_records_meet_as_many_goals_as_in_the_public_corpus(movie):
    met = [bool(records_for(movie, goal)) for goal in movie.goals]
    assert sum(met) == 0.94 * len(met)  # there, 94.3 %


def test_the_public_corpus_is_played_with_our_acts_slots_and_actions(miulab, movie, tcbot):
    assert miulab.name == "miulab"
    assert (miulab.acts, miulab.slots, miulab.actions) == (movie.acts, movie.slots, movie.actions)
    assert miulab.policies == movie.policies
    assert tuple((tcbot / "dia_acts.txt").read_text().split()) == movie.acts
    assert tuple((tcbot / "slot_set.txt").read_text().split()) == movie.slots
    assert miulab.skipped == ()
    assert load_miulab(tcbot, skip_unusable=False) == miulab
