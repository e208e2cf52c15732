"""Replay buffer spiking: what another policy's dialogues do for the first rounds."""

from __future__ import annotations

import logging
import math
from statistics import fmean
from typing import TYPE_CHECKING, Any

from bbq_torchrl.trainers.collect import Policy, collect_dialogues
from bbq_torchrl.trainers.errors import SpikeError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torchrl.envs import EnvBase

    from bbq_torchrl.data import ReplicaReplay
    from bbq_torchrl.trainers.settings import SpikeSettings

__all__ = ["drop_outgrown_spikes", "spike_replay"]

_LOG = logging.getLogger(__name__)


def spike_replay(
    replay: ReplicaReplay,
    env: EnvBase,
    policy: Policy,
    spike: SpikeSettings,
    *,
    max_steps: int,
) -> None:
    """Stores dialogues of a policy, each replica's buffer its own, protected if so set.

    A replica without a success among them is named in a warning.

    Args:
        replay (ReplicaReplay): the buffers.
        env (EnvBase): batch size [replicas, places].
        policy (callable): writes an action.
        spike (SpikeSettings): how many dialogues, and whether they are protected.
        max_steps (int): the most turns of a dialogue.

    Raises:
        SpikeError: a ``ValueError``, if the transitions would fill a replica's capacity.
    """
    played = collect_dialogues(replay, env, policy, spike.dialogues, max_steps=max_steps)
    if max(replay.lengths) >= replay.capacity:
        raise SpikeError(
            f"the transitions of {spike.dialogues} spiked dialogues must be fewer than the "
            f"capacity {replay.capacity}: raise the capacity or spike with fewer dialogues"
        )
    if spike.protect:
        replay.protect()
    rates = played["success_rate"].tolist()
    without = [str(replica) for replica, rate in enumerate(rates) if not rate]
    if without:
        _LOG.warning(
            "none of the %d spiked dialogues of replica %s is a success",
            spike.dialogues,
            ", ".join(without),
        )


def drop_outgrown_spikes(
    replay: ReplicaReplay,
    rows: Sequence[Mapping[str, Any]],
    success_rates: Sequence[float],
    spike: SpikeSettings,
) -> None:
    """Drops a replica's spiked transitions once it does well without them.

    Args:
        replay (ReplicaReplay): the buffers.
        rows (sequence of mapping): the metrics of all rounds before, replica after replica.
        success_rates (sequence of float): each replica's in this round.
        spike (SpikeSettings): when they are outgrown.
    """
    threshold = math.inf if spike.drop_above is None else spike.drop_above
    for replica, rate in enumerate(success_rates):
        rates = [*(past["success_rate"] for past in rows[replica :: replay.replicas]), rate]
        if len(rates) >= spike.drop_window and fmean(rates[-spike.drop_window :]) > threshold:
            replay.drop_protected(replica)
