"""A progress bar over rounds, on stderr."""

from __future__ import annotations

import multiprocessing
from datetime import datetime, timedelta
from statistics import fmean
from typing import TYPE_CHECKING

from tqdm import tqdm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.trainers.metrics import MetricRow

__all__ = ["RoundProgress"]


class RoundProgress:
    """Shows success, reward, KL, seconds a round and the expected end; means over the replicas.

    Args:
        rounds (int): how many rounds the training has.
        done (int): how many of them are done already (a resumed run). Default: 0.
        visible (bool, optional): whether the bar is shown. Default: ``None``, where stderr is a
            terminal and no other process of a sweep draws on it.
    """

    def __init__(self, rounds: int, *, done: int = 0, visible: bool | None = None) -> None:
        self._left = rounds - done
        if visible is None and multiprocessing.parent_process() is not None:
            visible = False
        self._bar = tqdm(
            total=rounds,
            initial=done,
            desc="rounds",
            unit="round",
            dynamic_ncols=True,
            disable=None if visible is None else not visible,
        )
        self._seconds: list[float] = []

    def update(self, rows: Sequence[MetricRow]) -> None:
        """Takes in the rows of one round, one for each replica."""
        self._left -= 1
        if self._bar.disable:
            return
        means = {name: fmean(row[name] for row in rows) for name in rows[0]}
        # The last rounds predict the next ones: rounds get longer until the buffer is full.
        self._seconds = [*self._seconds[-9:], means["seconds"]]
        left = timedelta(seconds=self._left * fmean(self._seconds))
        end = datetime.now().astimezone() + left
        shown = {"success": f"{means['success_rate']:.2f}", "reward": f"{means['reward']:.1f}"}
        if "kl" in means:
            shown["kl"] = f"{means['kl']:.0f}"
        shown |= {"s/round": f"{means['seconds']:.1f}", "end": f"{end:%H:%M:%S}"}
        self._bar.set_postfix(shown, refresh=False)
        self._bar.update()

    def close(self) -> None:
        """Leaves the bar as it is and ends its line."""
        self._bar.close()
