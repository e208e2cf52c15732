"""Runs the benchmarks and keeps their times in results/speed.json.

``scripts/write_docs.py`` makes the tables of docs/performance.md from it.

    python scripts/measure_speed.py                 all benchmarks
    python scripts/measure_speed.py bench_update    those of benchmarks/bench_update.py
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
FILE = ROOT / "results" / "speed.json"
PACKAGES = ("torch", "tensordict", "torchrl")


def run(name: str) -> dict[str, Any]:
    """Returns the command, the machine and the times of one file of benchmarks."""
    arguments = ["-m", "pytest", f"benchmarks/{name}.py", "--benchmark-enable"]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "benchmarks.json"
        subprocess.run(
            [sys.executable, *arguments, f"--benchmark-json={file}", "-q"],
            check=True,
            cwd=ROOT,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        report = json.loads(file.read_text(encoding="utf-8"))
    return {
        "command": "OMP_NUM_THREADS=1 python " + " ".join(arguments),
        "processor": report["machine_info"]["cpu"].get("brand_raw", "unknown"),
        "versions": {package: version(package) for package in PACKAGES},
        "times": [
            {
                "name": entry["name"],
                "seconds": entry["stats"]["min"],
                "rounds": entry["stats"]["rounds"],
                **entry["extra_info"],
            }
            for entry in report["benchmarks"]
        ],
    }


def main() -> None:
    """Runs the files named, or all; what was measured before of the others is kept."""
    known = sorted(path.stem for path in (ROOT / "benchmarks").glob("bench_*.py"))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", choices=[*known, []], help="default: all")
    chosen = parser.parse_args().files or known
    measured = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
    measured |= {name: run(name) for name in chosen}
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(json.dumps(measured, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
