"""Evaluation: dialogues a second.

    OMP_NUM_THREADS=1 pytest benchmarks/bench_evaluation.py --benchmark-enable --benchmark-only

10,000 dialogues of an agent that has learned nothing, 2,500 side by side, as at the end of a run:
by the network at the mean weights, by the mean of ten draws, by a draw; and by the rule policy.
"""

from __future__ import annotations

import pytest

from bbq_torchrl.cli.agent import make_agent
from bbq_torchrl.cli.store import compose
from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.evaluation.play import evaluate

DIALOGUES, PLACES = 10_000, 2_500


@pytest.mark.parametrize("policy", ["mean", "average", "draw", "dqn", "rule"])
def test_dialogues(benchmark, policy):
    dialogues, places = (20, 10) if benchmark.disabled else (DIALOGUES, PLACES)
    env = DialogueEnv(movie_domain(), batch_size=(1, places), seed=0)
    if policy == "rule":
        player = scripted_policy("rule", env)
    elif policy == "dqn":
        config = compose(["agent=dqn"])
        _, player = config.agent.make_evaluation(make_agent(config, env).actor)
    else:
        config = compose(["agent=bbqn"])
        _, player = config.agent.make_evaluation(make_agent(config, env).actor, policy)
    played = benchmark.pedantic(lambda: evaluate(env, player, dialogues), rounds=3)
    assert played.success.shape == (1, dialogues)
    if not benchmark.disabled:
        median = benchmark.stats.stats.median
        benchmark.extra_info["dialogues_per_second"] = round(dialogues / median)
