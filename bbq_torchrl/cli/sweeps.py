"""What a sweep leaves: a table of its runs."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

import yaml

from bbq_torchrl.cli.resume import is_finished, run_config
from bbq_torchrl.options.settings import ConfigError
from bbq_torchrl.run_folder import RESULT

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["table_of_runs"]

_HEAD = ("run", "overrides", "final success", "state")


def table_of_runs(sweep: Path, jobs: int) -> str:
    """Returns a line for each run of a sweep: folder, overrides, final success, state.

    Overrides that all runs have are left out.

    Args:
        sweep: the sweep's folder.
        jobs: how many jobs it has; 0 where only the sweeper knows.
    """
    folders = sorted((item.parent for item in sweep.rglob(".hydra")), key=_numbers_in_order)
    overrides = [_overrides(folder) for folder in folders]
    shared = set(overrides[0]).intersection(*overrides) if len(overrides) > 1 else set()
    rows = [
        (
            str(folder.relative_to(sweep)),
            " ".join(item for item in given if item not in shared),
            *_success_and_state(folder),
        )
        for folder, given in zip(folders, overrides, strict=True)
    ]
    finished = sum(state == "finished" for *_, state in rows)
    total = max(jobs, len(rows))
    if total > len(rows):
        rows.append(("–", "", "–", f"{total - len(rows)} never started"))
    table = [_HEAD, *rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = (
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    )
    return "\n".join([f"{finished} of {total} runs in {sweep} are finished", *lines])


def _success_and_state(folder: Path) -> tuple[str, str]:
    file = folder / RESULT
    unfinished = "–", "not finished: train.log in it says why"
    if not file.is_file():
        return unfinished
    try:
        rate = float(json.loads(file.read_text(encoding="utf-8"))["success_rate"])
    except (ValueError, TypeError, KeyError):
        return "–", f"{RESULT} is damaged"
    try:
        finished = is_finished(folder, run_config(folder).protocol.rounds)
    except ConfigError:
        finished = False
    return (f"{rate:.3f}", "finished") if finished else unfinished


def _overrides(folder: Path) -> list[str]:
    """Returns the overrides of a run as Hydra noted them; none where it did not."""
    file = folder / ".hydra" / "overrides.yaml"
    if not file.is_file():
        return []
    return [str(item) for item in yaml.safe_load(file.read_text(encoding="utf-8")) or []]


def _numbers_in_order(folder: Path) -> list[tuple[bool, int, str]]:
    """Returns what sorts ``2_dqn`` before ``10_dqn``."""
    parts = re.findall(r"\d+|\D+", str(folder))
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in parts]
