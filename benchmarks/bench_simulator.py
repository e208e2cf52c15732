"""The simulator: valid turns a second, features included, a random policy.

    OMP_NUM_THREADS=1 pytest benchmarks/bench_simulator.py --benchmark-enable -s

A round plays a batch of dialogues of the movie domain in lockstep from their start to the end of
the last one. Valid turns are those before a dialogue's end; the turns after it cost the same and do
not count. `simulator` is reset, draws, turns and features alone; `rollout` is the same through
`DialogueEnv.rollout` with TorchRL's bookkeeping and the policy. Aimed at: 10,000 a second with 50
dialogues and 60,000 with 4,096. On a busy machine `--benchmark-timer=time.process_time` is fairer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import torch

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy

if TYPE_CHECKING:
    from collections.abc import Callable

SIZES = (50, 1_000, 4_096, 16_384)
SEED = 0


def play_simulator(env: DialogueEnv) -> Callable[[], int]:
    """Returns a function that plays a batch on the simulator and counts its valid turns."""
    simulator, active = env.simulator, env.active_slots
    n_actions = len(env.domain.actions)

    def play() -> int:
        generator = torch.Generator().manual_seed(SEED)
        state = simulator.reset(simulator.draw_reset(env.batch_size, generator), active)
        simulator.observe(state, active)
        valid = 0
        while not state["done"].all():
            valid += int((~state["done"]).sum())
            action = torch.randint(n_actions, env.batch_size, generator=generator)
            draws = simulator.draw_turn(env.batch_size, generator)
            state = simulator.turn(state, action, draws, active)
            simulator.observe(state, active)
        return valid

    return play


def play_rollout(env: DialogueEnv) -> Callable[[], int]:
    """Returns a function that rolls a batch out and counts its valid turns."""
    policy = scripted_policy("random", env)

    def play() -> int:
        torch.manual_seed(SEED)
        env.set_seed(SEED)
        rollout = env.rollout(
            env.max_agent_turns, policy, break_when_any_done=False, break_when_all_done=True
        )
        done = rollout["next", "done"].squeeze(-1)
        return int(((done.cumsum(-1) - done.long()) == 0).sum())

    return play


@pytest.mark.parametrize("dialogues", SIZES)
@pytest.mark.parametrize("through", ["simulator", "rollout"])
def test_turns(benchmark, through, dialogues):
    torch.set_num_threads(1)
    env = DialogueEnv(movie_domain(), batch_size=(dialogues,), seed=SEED)
    play = {"simulator": play_simulator, "rollout": play_rollout}[through](env)
    rounds = 20 if dialogues < 4_096 else 5
    valid = benchmark.pedantic(play, rounds=rounds, warmup_rounds=1)
    assert valid > 10 * dialogues
    if benchmark.stats is not None:
        benchmark.extra_info |= {
            "valid_turns": valid,
            "valid_turns_per_second": round(valid / benchmark.stats.stats.min),
        }
        print(f"\n{through}, {dialogues} dialogues:", benchmark.extra_info)
