"""Adds a finished run to the table of its experiment in results/.

    python scripts/keep_result.py <run folder> ablations 0_reference/seed0

adds configuration, overrides, metrics and result to ``results/ablations/`` as the run
``0_reference/seed0``; a run of that name is replaced. Paths of this machine and times are left out.
:mod:`bbq_torchrl.evaluation.finished_runs` describes and reads the two files.
"""

from __future__ import annotations

import argparse
import csv
import json
import lzma
from io import StringIO
from itertools import groupby
from pathlib import Path
from typing import Any

import yaml

from bbq_torchrl.evaluation.finished_runs import RUNS, TABLE
from bbq_torchrl.evaluation.run_result import flat

RESULTS = Path(__file__).resolve().parent.parent / "results"

FOLDER = "<folder>"
"""Placeholder for a folder on the machine of the run."""

Run = dict[str, Any]
"""A run's ``config`` (by dotted key), ``overrides``, ``result``, and ``metrics`` (rows)."""


def keep(folder: Path, experiment: Path, name: str) -> None:
    """Adds a finished run.

    Args:
        folder: its run folder.
        experiment: the folder of the table, which is made if it does not exist.
        name: the run's name in the table.

    Raises:
        FileNotFoundError: if the run lacks a file, being unfinished, say.
    """
    run = _read_folder(folder)
    runs = read_table(experiment) if (experiment / RUNS).is_file() else {}
    write_table(experiment, runs | {name: run})


def _read_folder(folder: Path) -> Run:
    overrides = yaml.safe_load((folder / ".hydra" / "overrides.yaml").read_text(encoding="utf-8"))
    config = flat(yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8")))
    with (folder / "metrics.csv").open(encoding="utf-8", newline="") as file:
        metrics = [*csv.DictReader(file)]
    return {
        "config": {key: FOLDER if _is_path(key) else value for key, value in config.items()}
        | {"resume": None},
        "overrides": [
            f"{key}={FOLDER if _is_path(key) else value}"
            for key, _, value in (override.partition("=") for override in overrides)
        ],
        "result": json.loads((folder / "result.json").read_text(encoding="utf-8")),
        "metrics": [
            {key: cell for key, cell in row.items() if not key.startswith("seconds")}
            for row in metrics
        ],
    }


def _is_path(key: str) -> bool:
    return key.endswith("path")


def read_table(experiment: Path) -> dict[str, Run]:
    """Returns name -> run of an experiment."""
    about = json.loads((experiment / RUNS).read_text(encoding="utf-8"))
    with lzma.open(experiment / TABLE, "rt", encoding="utf-8", newline="") as file:
        rows = groupby(csv.DictReader(file), key=lambda row: row.pop("run"))
        metrics = {name: [*of_run] for name, of_run in rows}
    return {
        name: {**run, "config": about["config"] | run["config"], "metrics": metrics[name]}
        for name, run in about["runs"].items()
    }


def write_table(experiment: Path, runs: dict[str, Run]) -> None:
    """Writes the runs of an experiment, in the order of their names."""
    runs = {name: runs[name] for name in sorted(runs)}
    first, *others = (run["config"] for run in runs.values())
    shared = {
        key: value
        for key, value in first.items()
        if all(key in other and other[key] == value for other in others)
    }
    about = {
        name: {
            "config": {key: value for key, value in run["config"].items() if key not in shared},
            "overrides": run["overrides"],
            "result": run["result"],
        }
        for name, run in runs.items()
    }
    columns = dict.fromkeys(key for run in runs.values() for row in run["metrics"] for key in row)
    text = StringIO()
    writer = csv.DictWriter(text, ["run", *columns], lineterminator="\n")
    writer.writeheader()
    for name, run in runs.items():
        writer.writerows({"run": name, **row} for row in run["metrics"])
    experiment.mkdir(parents=True, exist_ok=True)
    (experiment / TABLE).write_bytes(lzma.compress(text.getvalue().encode(), preset=9))
    content = json.dumps({"config": shared, "runs": about}, indent=1)
    (experiment / RUNS).write_text(content + "\n", encoding="utf-8")


def main() -> None:
    """Adds the run given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="a finished run folder")
    parser.add_argument("experiment", help="a folder in results/")
    parser.add_argument("name", help="the run's name in it, such as bbqn_map/seed1")
    given = parser.parse_args()
    keep(given.run, RESULTS / given.experiment, given.name)


if __name__ == "__main__":
    main()
