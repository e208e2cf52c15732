"""Replay buffer spiking: what another policy's dialogues do for the first rounds."""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING

from bbq_torchrl.trainers.collect import Policy, play_dialogues, rows_per_replica

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torchrl.envs import EnvBase

    from bbq_torchrl.data import ReplicaReplay
    from bbq_torchrl.trainers.settings import SpikeSettings

__all__ = ["is_spike_outgrown", "spike_replay"]


def spike_replay(
    replay: ReplicaReplay, env: EnvBase, policy: Policy, spike: SpikeSettings, *, max_steps: int
) -> None:
    """Stores dialogues of a policy, each replica's buffer its own, protected if so set.

    Args:
        replay (ReplicaReplay): the buffers.
        env (EnvBase): batch size [replicas, places].
        policy (callable): writes an action.
        spike (SpikeSettings): how many dialogues, and whether they are protected.
        max_steps (int): the most turns of a dialogue.

    Raises:
        ValueError: if the transitions would fill a replica's capacity.
    """
    for rollout in play_dialogues(env, policy, spike.dialogues, max_steps=max_steps):
        rows = rows_per_replica(rollout, replay.keys)
        for length, td in zip(replay.lengths, rows, strict=True):
            if length + len(td) >= replay.capacity:
                raise ValueError(
                    f"the transitions of {spike.dialogues} spiked dialogues must be fewer than the "
                    f"capacity {replay.capacity}: raise the capacity or spike with fewer dialogues"
                )
        replay.extend(rows)
    if spike.protect:
        replay.protect()


def is_spike_outgrown(success_rates: Sequence[float], spike: SpikeSettings) -> bool:
    """Returns whether a replica's spiked transitions are to be dropped after a round.

    Args:
        success_rates (sequence of float): of all its rounds so far, this one the last.
        spike (SpikeSettings): the threshold and over how many rounds the mean is taken.

    Example:
        >>> from bbq_torchrl.trainers import SpikeSettings
        >>> spike = SpikeSettings(drop_above=0.5, drop_window=2)
        >>> is_spike_outgrown([0.9], spike), is_spike_outgrown([0.4, 0.5, 0.6], spike)
        (False, True)
    """
    if spike.drop_above is None or len(success_rates) < spike.drop_window:
        return False
    return fmean(success_rates[-spike.drop_window :]) > spike.drop_above
