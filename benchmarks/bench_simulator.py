"""The simulator: valid turns a second, features included.

    OMP_NUM_THREADS=1 pytest benchmarks/bench_simulator.py --benchmark-enable --benchmark-only

A round plays a batch of dialogues of the movie domain in lockstep from their start to the end of
the last one. Valid turns are those before a dialogue's end; the turns after it cost the same and do
not count. `simulator` is reset, draws, turns and features alone; `rollout` is the same through
`DialogueEnv.rollout` with TorchRL's bookkeeping and the policy. All with the domain's slot errors;
`rule` is the scripted policy. `times_public` compares with the public simulator, which on one core
does 411 turns a second with a random policy and 1,560 with the rule policy under errors.
"""

from __future__ import annotations

import pytest

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv
from benchmarks.parts.dialogues import PUBLIC_RANDOM, PUBLIC_RULE, play_rollout, play_simulator

SIZES = (50, 1_000, 4_096, 16_384)
PUBLIC = {"random": PUBLIC_RANDOM, "rule": PUBLIC_RULE}
CASES = [("random", size) for size in SIZES] + [("rule", 1_000)]


@pytest.mark.parametrize(("policy", "dialogues"), CASES)
@pytest.mark.parametrize("through", ["simulator", "rollout"])
def test_turns(benchmark, through, policy, dialogues):
    is_measured = not benchmark.disabled
    places = dialogues if is_measured else 5
    env = DialogueEnv(movie_domain(), batch_size=(places,), seed=0)
    play = {"simulator": play_simulator, "rollout": play_rollout}[through](env, policy)
    rounds = 20 if dialogues < 4_096 else 5
    valid = benchmark.pedantic(play, rounds=rounds, warmup_rounds=1)
    assert valid >= 2 * places
    if is_measured:
        speed = valid / benchmark.stats.stats.median
        benchmark.extra_info |= {
            "valid_turns": valid,
            "valid_turns_per_second": round(speed),
            "times_public": speed / PUBLIC[policy],
        }
