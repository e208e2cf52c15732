"""The shipped hotels and restaurants: consistent, small, and as hard as the movies."""

import pytest

from bbq_torchrl.cli.evaluate import composed, evaluation
from bbq_torchrl.domains import shipped_domain
from bbq_torchrl.options.env import DomainExtension

NAMES = ("hotel", "restaurant")


def success(name, policy, *overrides):
    """The success rate of a policy, and its standard error."""
    played = evaluation(composed([f"policy={policy}", f"domain={name}", *overrides]))
    return played["success_rate"], played["standard_error"]


@pytest.mark.parametrize("name", NAMES)
def test_a_record_meets_every_goal_and_has_what_it_requests(name):
    domain = shipped_domain(name)
    assert 30 <= len(domain.records) <= 100
    for goal in domain.goals:
        wanted = {s: v for s, v in goal.constraints.items() if s not in domain.free_slots}
        met = [row for row in domain.records if wanted.items() <= row.items()]
        assert any(all(slot in row for slot in goal.requests) for row in met), goal


@pytest.mark.parametrize("name", NAMES)
def test_a_domain_is_as_hard_for_the_rule_as_the_movies(name):
    rate, error = success(name, "rule")
    assert abs(rate - 0.183) < 0.005 + 3 * error


@pytest.mark.parametrize("name", NAMES)
def test_policies_that_know_more_succeed_more_often(name):
    order = ("random", "rule", "careful", "repair", "clairvoyant")
    rates = [success(name, policy, "dialogues=2000")[0] for policy in order]
    assert rates == sorted(rates)
    assert rates[0] < 0.05
    assert rates[-1] > 0.98


@pytest.mark.parametrize("name", NAMES)
def test_domain_extension_adds_every_slot(name):
    assert not DomainExtension().inactive_slots(shipped_domain(name))
