"""Replay buffer spiking: dialogues of another policy for the first rounds."""

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
        policy: writes an action.
        dialogues: how many of its dialogues each replica's buffer starts with.
        protect: whether their transitions are never evicted. Defaults to True.
        drop_above: a success rate. Once the mean over the last ``drop_window`` rounds of a replica
            is above it, its protected transitions are dropped for good. (The paper leaves this
            heuristic to future work and gives no number.) Defaults to None: never.
        drop_window: the number of rounds that the mean is taken over. One round of 50 dialogues has
            a standard error of up to .07: five rounds have .03. Defaults to 5.

    Raises:
        ValueError: for an argument outside of what is listed.
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
                    "drop_above needs protect=True: unprotected spiked transitions leave by "
                    f"themselves, got protect={self.protect} and drop_above={self.drop_above}"
                )

    def fill(self, replay: ReplicaReplay, env: EnvBase, *, max_steps: int) -> None:
        """Stores the dialogues, each replica's buffer its own, protected if so set.

        The log says how many of them succeed, and warns of a replica without a success.

        Args:
            replay: the buffers.
            env: batch size [replicas, places].
            max_steps: the most turns of a dialogue.

        Raises:
            SpikeError: a ``ValueError``, if the transitions would fill a replica's capacity.
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
                "none of the %d spiked dialogues of replica %s is a success",
                self.dialogues,
                ", ".join(without),
            )

    def drop_outgrown(
        self,
        replay: ReplicaReplay,
        rows: Sequence[Mapping[str, Any]],
        success_rates: Sequence[float],
    ) -> None:
        """Drops a replica's spiked transitions once it does well without them.

        Args:
            replay: the buffers.
            rows: the metrics of all rounds before, replica after replica.
            success_rates: each replica's in this round.
        """
        if self.drop_above is None:
            return
        for replica, rate in enumerate(success_rates):
            rates = [*(past["success_rate"] for past in rows[replica :: replay.replicas]), rate]
            last = rates[-self.drop_window :]
            if len(last) == self.drop_window and fmean(last) > self.drop_above:
                replay.drop_protected(replica)
