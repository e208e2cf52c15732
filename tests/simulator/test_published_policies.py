"""Scripted policies against their success in the public simulator, on its corpus."""

import pytest

from bbq_torchrl.domains import load_miulab
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.trainers import evaluate

COUNT = 20_000
STANDARD_ERRORS = 4.5
GOALS = {
    "v1": "user_goals_first_turn_template.part.movie.v1.p",
    "v2": "user_goals_first_turn_template.v2.p",
}

pytestmark = pytest.mark.slow


def success_rate(tcbot, goals, policy, **settings):
    domain = load_miulab(tcbot, goals=GOALS[goals])
    env = DialogueEnv(domain, batch_size=(COUNT,), seed=0, **settings)
    return evaluate(env, scripted_policy(policy, env), COUNT).success.double().mean().item()


@pytest.mark.parametrize(
    ("policy", "goals", "slot_error_prob", "published", "standard_error"),
    [
        ("rule", "v1", 0.0, 0.416, 0.011),
        ("rule", "v2", 0.0, 0.286, 0.014),
        ("rule", "v2", 0.05, 0.191, 0.005),
        ("rule_inform", "v1", 0.0, 0.560, 0.011),
        ("rule_inform", "v2", 0.0, 0.441, 0.016),
        ("careful", "v1", 0.0, 0.9205, 0.006),
        ("careful", "v2", 0.0, 0.824, 0.010),
        # These four are published without errors, so that of the first is used.
        ("rule", "v1", 0.05, 0.317, 0.011),
        ("rule", "v1", 0.10, 0.216, 0.011),
        ("rule", "v1", 0.20, 0.114, 0.011),
        ("rule", "v1", 0.30, 0.046, 0.011),
    ],
)
def test_a_policy_succeeds_as_often_as_in_the_public_simulator(
    tcbot, policy, goals, slot_error_prob, published, standard_error
):
    rate = success_rate(tcbot, goals, policy, slot_error_prob=slot_error_prob)
    own_error = (published * (1 - published) / COUNT) ** 0.5
    assert abs(rate - published) < STANDARD_ERRORS * (own_error**2 + standard_error**2) ** 0.5


def test_intent_errors_alone_change_nothing_for_the_rule_policy(tcbot):
    plain = success_rate(tcbot, "v1", "rule", slot_error_prob=0.0)
    assert success_rate(tcbot, "v1", "rule", slot_error_prob=0.0, intent_error_prob=0.5) == plain


def test_a_random_policy_hardly_ever_succeeds(tcbot):
    assert success_rate(tcbot, "v1", "random", slot_error_prob=0.0) < 0.003
