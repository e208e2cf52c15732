"""Scripted policies in the oracle against the public simulator's success on its own corpus."""

from __future__ import annotations

from math import sqrt
from random import Random

import pytest

from bbq_torchrl.domains import load_miulab

from .dialogue import Dialogue, World
from .draws import reset_draws, turn_draws
from .policies import ASKED_BESIDES, ASKED_BY_RULE, RULE, RULE_INFORM, careful, follow

DIALOGUES = 6_000
STANDARD_ERRORS = 4.5
GOALS = {
    "v1": "user_goals_first_turn_template.part.movie.v1.p",
    "v2": "user_goals_first_turn_template.v2.p",
}
POLICIES = {
    "rule": follow(RULE),
    "rule with informs": follow(RULE_INFORM),
    "careful": careful(ASKED_BY_RULE + ASKED_BESIDES),
}

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("policy", "goals", "slot_error_prob", "published", "standard_error"),
    [
        ("rule", "v1", 0.0, 0.416, 0.011),
        ("rule", "v2", 0.0, 0.286, 0.014),
        ("rule", "v2", 0.05, 0.191, 0.005),
        ("rule with informs", "v1", 0.0, 0.560, 0.011),
        ("rule with informs", "v2", 0.0, 0.441, 0.016),
        ("careful", "v1", 0.0, 0.9205, 0.006),
        ("careful", "v2", 0.0, 0.824, 0.010),
        # No error is given with these four; theirs is that of the first.
        ("rule", "v1", 0.05, 0.317, 0.011),
        ("rule", "v1", 0.10, 0.216, 0.011),
        ("rule", "v1", 0.20, 0.114, 0.011),
        ("rule", "v1", 0.30, 0.046, 0.011),
    ],
)
def test_a_scripted_policy_succeeds_as_often_as_in_the_public_simulator(
    tcbot, policy, goals, slot_error_prob, published, standard_error
):
    world = World(load_miulab(tcbot, goals=GOALS[goals]), slot_error_prob=slot_error_prob)
    success = share_of_successes(world, POLICIES[policy], seed=1)
    own_error = sqrt(published * (1 - published) / DIALOGUES)
    assert abs(success - published) < STANDARD_ERRORS * sqrt(own_error**2 + standard_error**2)


def test_intent_errors_alone_change_nothing_for_the_rule_policy(tcbot):
    domain = load_miulab(tcbot, goals=GOALS["v1"])
    plain = share_of_successes(World(domain), POLICIES["rule"], seed=2)
    noisy = share_of_successes(World(domain, intent_error_prob=0.5), POLICIES["rule"], seed=2)
    assert noisy == plain


def test_a_random_agent_hardly_ever_succeeds(tcbot):
    world = World(load_miulab(tcbot, goals=GOALS["v1"]))
    random = Random(3)
    names = [str(action) for action in world.domain.actions]
    assert share_of_successes(world, lambda _: random.choice(names), seed=3) < 0.005


def share_of_successes(world, policy, *, seed):
    random = Random(seed)
    n_slots = len(world.slots)
    actions = {str(action): action for action in world.domain.actions}
    successes = 0
    for _ in range(DIALOGUES):
        dialogue = Dialogue(world, reset_draws(random, n_slots))
        while not dialogue.done:
            dialogue.turn(actions[policy(dialogue)], turn_draws(random, n_slots))
        successes += dialogue.success
    return successes / DIALOGUES
