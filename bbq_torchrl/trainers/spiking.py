"""Replay buffer spiking: dialogues of another policy, stored before training."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Any

from bbq_torchrl.checks import BELOW_ONE, at_least, check
from bbq_torchrl.trainers.collect import Policy, collect_dialogues
from bbq_torchrl.trainers.errors import SpikeError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torchrl.envs import EnvBase

    from bbq_torchrl.data import ReplicaReplay

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Spike:
    """Fills the buffers before the first round with dialogues of another policy.

    Args:
        policy: a policy that writes an action.
        dialogues: the number of its dialogues in each replica's buffer.
        protect: whether their transitions are never evicted. Defaults to True.
        drop_above: a success rate. Once a replica's mean over the last ``drop_window`` rounds is
            above it, its protected transitions are dropped for good. (The paper leaves this
            heuristic to future work and gives no number.) Defaults to None: never.
        drop_window: the number of rounds in the mean. One round of 50 dialogues has a standard
            error of up to 0.07, five rounds of 0.03. Defaults to 5.

    Raises:
        ValueError: for an invalid argument.
    """

    policy: Policy
    dialogues: int
    protect: bool = True
    drop_above: float | None = None
    drop_window: int = 5

    def __post_init__(self) -> None:
        for name in ("dialogues", "drop_window"):
            check(name, getattr(self, name), at_least(1))
        if self.drop_above is not None:
            check("drop_above", self.drop_above, BELOW_ONE)
            if not self.protect:
                raise ValueError(
                    "drop_above needs protect=True, as unprotected spiked transitions are evicted "
                    f"anyway, got protect={self.protect} and drop_above={self.drop_above}"
                )

    def fill(self, replay: ReplicaReplay, env: EnvBase, *, max_steps: int) -> None:
        """Plays and stores the dialogues of each replica, and protects them if so set.

        The log has their success rate, and a warning for each replica without a success.

        Args:
            replay: the buffers.
            env: an environment of batch size [replicas, parallel].
            max_steps: the maximum number of turns of a dialogue.

        Raises:
            SpikeError: if the transitions would fill a replica's capacity.
        """
        played = collect_dialogues(replay, env, self.policy, self.dialogues, max_steps=max_steps)
        if max(replay.lengths) >= replay.capacity:
            raise SpikeError(
                f"the transitions of {self.dialogues} spiked dialogues must be fewer than the "
                f"capacity {replay.capacity}: raise the capacity or spike with fewer dialogues"
            )
        if self.protect:
            replay.protect()
        rates = played["success_rate"].tolist()
        _LOG.info(
            "%.1f %% of the %d dialogues that spike the buffer succeed",
            100 * fmean(rates),
            self.dialogues,
        )
        without = [str(replica) for replica, rate in enumerate(rates) if not rate]
        if without:
            _LOG.warning(
                "none of the %d spiked dialogues of replica %s succeeds",
                self.dialogues,
                ", ".join(without),
            )

    def drop_outgrown(
        self,
        replay: ReplicaReplay,
        rows: Sequence[Mapping[str, Any]],
        success_rates: Sequence[float],
    ) -> None:
        """Drops a replica's spiked transitions once its success rate is high enough.

        Args:
            replay: the buffers.
            rows: the metrics of all earlier rounds, replica after replica.
            success_rates: the success rate of each replica in this round.
        """
        if self.drop_above is None:
            return
        for replica, rate in enumerate(success_rates):
            rates = [*(past["success_rate"] for past in rows[replica :: replay.replicas]), rate]
            last = rates[-self.drop_window :]
            if len(last) == self.drop_window and fmean(last) > self.drop_above:
                replay.drop_protected(replica)
