"""The progress of training: a bar on a terminal, log lines elsewhere."""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import sys
from statistics import fmean
from typing import TYPE_CHECKING

from tqdm import tqdm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.trainers.metrics import MetricRow

_LOG = logging.getLogger(__name__)

LINES = 40
"""The maximum number of log lines of a training run without a progress bar."""


class RoundProgress:
    """Shows success, reward, KL and remaining time, averaged over the replicas.

    Without a bar a line is logged after every round. Training for more than 40 rounds logs at most
    40 lines, each with means over the rounds since the last.

    Args:
        rounds: the number of rounds.
        done: the number of finished rounds (of a resumed run). Defaults to 0.
        visible: whether the bar is shown. Defaults to None: if stderr is a terminal and no other
            process of a sweep draws on it. A terminal without columns or lines never shows it.
        name: the prefix of each log line. Defaults to "".
    """

    def __init__(
        self, rounds: int, *, done: int = 0, visible: bool | None = None, name: str = ""
    ) -> None:
        self._rounds = rounds
        self._remaining = rounds - done
        self._name = f"{name}: " if name else ""
        self._pending: list[dict[str, float]] = []
        is_in_sweep = visible is None and multiprocessing.parent_process() is not None
        if is_in_sweep or _has_zero_size():
            visible = False
        self._bar = tqdm(
            total=rounds,
            initial=done,
            desc="rounds",
            unit="round",
            dynamic_ncols=True,
            disable=None if visible is None else not visible,
        )

    def update(self, rows: Sequence[MetricRow]) -> None:
        """Shows the rows of one round, one for each replica."""
        self._remaining -= 1
        means = {name: fmean(row[name] for row in rows) for name in rows[0]}
        self._pending.append(means)
        rates = [row.get("eval_success_rate", math.nan) for row in self._pending]
        evaluated = [f"{rate:.2f}" for rate in rates if not math.isnan(rate)]
        if self._bar.disable:
            self._log_line(*evaluated[-1:])
            return
        shown = {"success": f"{means['success_rate']:.2f}", "reward": f"{means['reward']:.1f}"}
        if evaluated:
            shown["eval"] = evaluated[-1]
        if "kl" in means:
            shown["kl"] = f"{means['kl']:.0f}"
        self._bar.set_postfix(shown, refresh=False)
        self._bar.update()

    def _log_line(self, *evaluated: str) -> None:
        """Logs a line if enough rounds have passed since the last one."""
        done = self._rounds - self._remaining
        if done % math.ceil(self._rounds / LINES) and self._remaining:
            return
        names = ("success_rate", "reward", "seconds")
        success, reward, seconds = (fmean(row[name] for row in self._pending) for name in names)
        _LOG.info(
            "%sround %d of %d: success %.2f%s, reward %.1f, %.1f s a round",
            self._name,
            done,
            self._rounds,
            success,
            "".join(f", evaluation {rate}" for rate in evaluated),
            reward,
            seconds,
        )
        self._pending = []

    def close(self) -> None:
        """Leaves the bar as it is and ends its line."""
        self._bar.close()


def _has_zero_size() -> bool:
    """Returns whether stderr is a terminal of size 0, as in containers: tqdm draws nothing."""
    try:
        return min(os.get_terminal_size(sys.stderr.fileno())) < 1
    except (AttributeError, OSError, ValueError):  # not a terminal, or not a file stream
        return False
