"""Saves the files of a finished run that the documentation needs, in results/.

    python scripts/keep_result.py <run folder> ablations/reference

copies configuration, command line, metrics and result to ``results/ablations/reference``. Paths
of this machine are left out.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

import yaml

RESULTS = Path(__file__).resolve().parent.parent / "results"

FOLDER = "<folder>"
"""Placeholder for a folder on the machine of the run."""


def keep(run: Path, target: Path) -> None:
    """Copies a finished run.

    Args:
        run: its run folder.
        target: the result folder to make; one that exists is replaced.

    Raises:
        FileNotFoundError: if the run lacks a file, being unfinished, say.
    """
    config = yaml.safe_load((run / "config.yaml").read_text(encoding="utf-8"))
    overrides = yaml.safe_load((run / ".hydra" / "overrides.yaml").read_text(encoding="utf-8"))
    result = json.loads((run / "result.json").read_text(encoding="utf-8"))
    for group in config.values():
        if isinstance(group, dict) and "path" in group:
            group["path"] = FOLDER
    config["resume"] = None
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    _write(target / "config.yaml", config)
    _write(target / "overrides.yaml", [_without_path(item) for item in overrides])
    (target / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    shutil.copyfile(run / "metrics.csv", target / "metrics.csv")


def _without_path(override: str) -> str:
    key, _, value = override.partition("=")
    return f"{key}={FOLDER if key.endswith('path') else value}"


def _write(file: Path, content: Any) -> None:
    file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def main() -> None:
    """Saves the run given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="a finished run folder")
    parser.add_argument("name", help="<experiment>/<run> in results/")
    arguments = parser.parse_args()
    keep(arguments.run, RESULTS / arguments.name)


if __name__ == "__main__":
    main()
