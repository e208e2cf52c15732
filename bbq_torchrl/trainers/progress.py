"""The progress of a training: a bar on a terminal, lines in the log elsewhere."""

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
"""The most log lines of a training without a progress bar."""


class RoundProgress:
    """Shows success, reward, KL and the time that is left; means over the replicas.

    Where no bar is shown, the log gets a line after every round, of a training of more than 40
    rounds after every so many that it is at most 40 lines: means over the rounds since the last.

    Args:
        rounds: how many rounds the training has.
        done: how many of them are done already (a resumed run). Defaults to 0.
        visible: whether the bar is shown. Defaults to None: where stderr is a terminal and no other
            process of a sweep draws on it. A terminal of no columns or lines never shows it.
        name: begins each line of the log. Defaults to "".
    """

    def __init__(
        self, rounds: int, *, done: int = 0, visible: bool | None = None, name: str = ""
    ) -> None:
        self._rounds = rounds
        self._left = rounds - done
        self._name = f"{name}: " if name else ""
        self._unsaid: list[dict[str, float]] = []
        is_of_a_sweep = visible is None and multiprocessing.parent_process() is not None
        if is_of_a_sweep or _is_without_a_size():
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
        """Takes in the rows of one round, one for each replica."""
        self._left -= 1
        means = {name: fmean(row[name] for row in rows) for name in rows[0]}
        self._unsaid.append(means)
        rates = [row.get("eval_success_rate", math.nan) for row in self._unsaid]
        evaluated = [f"{rate:.2f}" for rate in rates if not math.isnan(rate)]
        if self._bar.disable:
            self._tell(*evaluated[-1:])
            return
        shown = {"success": f"{means['success_rate']:.2f}", "reward": f"{means['reward']:.1f}"}
        if evaluated:
            shown["eval"] = evaluated[-1]
        if "kl" in means:
            shown["kl"] = f"{means['kl']:.0f}"
        self._bar.set_postfix(shown, refresh=False)
        self._bar.update()

    def _tell(self, *evaluated: str) -> None:
        """Logs a line if enough rounds have passed since the last one."""
        done = self._rounds - self._left
        if done % math.ceil(self._rounds / LINES) and self._left:
            return
        names = ("success_rate", "reward", "seconds")
        success, reward, seconds = (fmean(row[name] for row in self._unsaid) for name in names)
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
        self._unsaid = []

    def close(self) -> None:
        """Leaves the bar as it is and ends its line."""
        self._bar.close()


def _is_without_a_size() -> bool:
    """Tells whether stderr is a terminal on which tqdm would draw nothing, as in a container."""
    try:
        return min(os.get_terminal_size(sys.stderr.fileno())) < 1
    except (AttributeError, OSError, ValueError):  # no terminal, or no stream of a file
        return False
