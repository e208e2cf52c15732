"""Measures every speed that docs/performance.md shows, and keeps the figures in results/.

    python scripts/measure_speed.py --label 0.2.0          everything, as the figures of a version
    python scripts/measure_speed.py bench_update floor     these, in the place of the last ones

It runs ``benchmarks/bench_*.py`` (results/speed.json), ``benchmarks/floor.py`` (floor.json),
``benchmarks/compare.py`` (compare.json) and ``benchmarks/growth.py`` (growth.csv). With ``--label``
the comparison's figures that have a target become the measured ones of that version in
speed_history.csv; what was predicted for it, in the same file, stays. Then
``scripts/write_docs.py`` makes tables and figures. About an hour on one core, which nothing
else should use.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "results"
HISTORY = RESULTS / "speed_history.csv"
COLUMNS = ("version", "what", "unit", "predicted", "measured")
PACKAGES = ("torch", "tensordict", "torchrl")


def python(*arguments: str) -> str:
    """Runs this Python on one thread in the project's folder. Returns what it prints."""
    return subprocess.run(
        [sys.executable, *arguments],
        check=True,
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    ).stdout


def measure_benchmarks(name: str) -> None:
    """Runs one file of benchmarks and keeps its times."""
    arguments = ["-m", "pytest", f"benchmarks/{name}.py", "--benchmark-enable"]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "benchmarks.json"
        # without the option a benchmark that is skipped (it needs a GPU, say) is an error
        skips = "-Wignore::pytest_benchmark.logger.PytestBenchmarkWarning"
        python(*arguments, f"--benchmark-json={file}", "-q", skips)
        if not file.is_file() or not file.stat().st_size:
            sys.stderr.write(f"skipped: {name} has nothing to measure on this machine\n")
            return
        report = json.loads(file.read_text(encoding="utf-8"))
    times = [
        {
            "name": entry["name"],
            "seconds": entry["stats"]["min"],
            "rounds": entry["stats"]["rounds"],
            **entry["extra_info"],
        }
        for entry in report["benchmarks"]
    ]
    # Read only now: a measurement takes minutes, and another may have ended meanwhile.
    file = RESULTS / "speed.json"
    measured = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    measured[name] = {**_described(*arguments), "times": times}
    _write(file, dict(sorted(measured.items())))


def measure_comparison() -> None:
    """Runs the comparison with the targets and keeps its rows."""
    rows = json.loads(python("benchmarks/compare.py", "--json"))
    _write(RESULTS / "compare.json", {**_described("benchmarks/compare.py"), "rows": rows})


def measure_floor() -> None:
    """Measures the machine and keeps the least times."""
    python("benchmarks/floor.py")


def measure_growth() -> None:
    """Measures growth anew."""
    python("benchmarks/growth.py", "--fresh")


def _described(*arguments: str) -> dict[str, Any]:
    return {
        "command": "OMP_NUM_THREADS=1 python " + " ".join(arguments),
        "processor": _processor(),
        "versions": {package: version(package) for package in PACKAGES},
    }


def _processor() -> str:
    from cpuinfo import get_cpu_info  # pytest-benchmark's own

    return str(get_cpu_info().get("brand_raw", "unknown"))


def _write(file: Path, content: dict[str, Any]) -> None:
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def keep_version(label: str, rows: list[dict[str, Any]], file: Path = HISTORY) -> None:
    """Makes the figures that have a target those of a version; its predictions stay.

    Args:
        label: the version.
        rows: of the comparison.
        file: the history.
    """
    lines: list[dict[str, str]] = []
    if file.is_file():
        with file.open(newline="", encoding="utf-8") as opened:
            lines = list(csv.DictReader(opened))
    known = {(line["version"], line["what"]): line for line in lines}
    for row in rows:
        if row["target"] is None:
            continue
        line = known.get((label, row["what"]))
        if line is None:
            line = {"version": label, "what": row["what"], "unit": row["unit"], "predicted": ""}
            lines.append(line)
        line["measured"] = f"{float(format(row['measured'], '.4g')):g}"  # no exponent
    with file.open("w", newline="", encoding="utf-8") as opened:
        writer = csv.DictWriter(opened, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def main() -> None:
    """Measures what is named, or all."""
    benchmarks = sorted(path.stem for path in (ROOT / "benchmarks").glob("bench_*.py"))
    others = {
        "floor": measure_floor,
        "compare": measure_comparison,
        "growth": measure_growth,
    }
    known = [*others, *benchmarks]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="*", choices=[*known, []], help="default: all")
    parser.add_argument("--label", help="the version whose figures these are")
    chosen = parser.parse_args()
    for what in chosen.what or known:
        sys.stderr.write(f"measuring: {what}\n")
        if what in others:
            others[what]()
        else:
            measure_benchmarks(what)
    if chosen.label:
        compared = json.loads((RESULTS / "compare.json").read_text(encoding="utf-8"))
        keep_version(chosen.label, compared["rows"])
    python("scripts/write_docs.py")


if __name__ == "__main__":
    main()
