"""The tables of examples/deep_sea, from results/deep_sea.csv and deep_sea_trials.csv."""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from scripts.docs_blocks.markdown import table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["deep_sea_blocks"]

ROOT = Path(__file__).resolve().parents[2]
TRIALS = ROOT / "results" / "deep_sea_trials.csv"

# An example is a folder of scripts, no package.
sys.path.append(str(ROOT / "examples" / "deep_sea"))


def deep_sea_blocks() -> dict[str, Callable[[], str]]:
    """Returns the blocks of the example's page."""
    return {"deep_sea.results": _results, "deep_sea.trials": _trials}


def _results() -> str:
    from deep_sea_results import AGENT_NAMES, read
    from deep_sea_results import table as results_table

    return results_table(read(), list(AGENT_NAMES))


def _trials() -> str:
    with TRIALS.open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    return table(list(lines[0]), [list(line.values()) for line in lines])
