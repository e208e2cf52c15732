"""Playing many dialogues with a policy that does not learn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torchrl.envs.utils import ExplorationType

from bbq_torchrl.trainers import EpisodeStats, Policy, derive_seed, episode_stats, rollouts

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tensordict import TensorDictBase
    from torchrl.envs import EnvBase


def evaluate(
    env: EnvBase, policy: Policy, dialogues: int, *, seed: int = 0, max_steps: int = 1000
) -> EpisodeStats:
    """Plays exactly so many dialogues without exploration, each to its end: how did they go?

    Dialogues run side by side in lockstep, so that long ones count as much as short ones.

    Args:
        env: batch size [*replicas, places].
        policy: writes an action.
        dialogues: for each replica.
        seed: of everything random in them.
        max_steps: the most turns of a dialogue; one that is longer is an error.

    Returns:
        success (bool), reward (float64) and turns (int64), each of shape [*replicas, dialogues].
    """
    batches = evaluation_rollouts(env, policy, dialogues, seed=seed, max_steps=max_steps)
    stats = [episode_stats(batch) for batch in batches]
    return EpisodeStats(*(torch.cat(parts, -1) for parts in zip(*stats, strict=True)))


def evaluation_rollouts(
    env: EnvBase, policy: Policy, dialogues: int, *, seed: int = 0, max_steps: int = 1000
) -> Iterator[TensorDictBase]:
    """Yields the dialogues that :func:`evaluate` counts, a batch at a time.

    Args are those of :func:`evaluate`; the rollouts are those of
    :func:`~bbq_torchrl.trainers.rollouts`.
    """
    torch.manual_seed(derive_seed(seed, "torch", "evaluate"))
    env.set_seed(derive_seed(seed, "env", "evaluate"))
    greedy = ExplorationType.DETERMINISTIC
    yield from rollouts(env, policy, dialogues, max_steps=max_steps, exploration=greedy)
