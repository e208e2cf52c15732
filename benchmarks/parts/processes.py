"""Time and memory of commands in separate processes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

from benchmarks.parts.rows import Row

if TYPE_CHECKING:
    from benchmarks.parts.sizes import Sizes

ROOT = Path(__file__).resolve().parents[2]


class Used(NamedTuple):
    """The time and memory of a process.

    Attributes:
        wall: seconds from its start to its end.
        cpu: seconds of processor time.
        peak_bytes: the most memory resident at a time.
    """

    wall: float
    cpu: float
    peak_bytes: int


def python(*arguments: str) -> Used:
    """Runs this Python on one thread, in the project's folder, without its output.

    Raises:
        RuntimeError: if it fails; with what it said.
    """
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    started = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    ) as process:
        said = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(arguments)} failed: {said.decode(errors='replace')[-2000:]}")
    return Used(
        time.perf_counter() - started,
        usage.ru_utime + usage.ru_stime,
        usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024),
    )


MEMORY_GB, HELP_SECONDS = 1.5, 6


def process(sizes: Sizes) -> list[Row]:
    """The peak memory of a run with full buffers; the time until help is shown."""
    overrides = ("agent=bbqn", "env=full", *sizes.memory, *sizes.overrides)
    protocol = ("spike.protect=false", f"protocol.eval_dialogues={sizes.eval_dialogues}")
    with TemporaryDirectory() as folder:
        given = (*overrides, *protocol, f"hydra.run.dir={folder}/run")
        peak = python("train.py", *given).peak_bytes / 1e9
    what = f"agent=bbqn env=full {sizes.memory[0]}: peak of resident memory"
    wall = median(python("train.py", "--help").wall for _ in range(min(sizes.repeats, 3)))
    return [
        Row("process", what, "GB", peak, MEMORY_GB),
        Row("process", "python train.py --help", "s", wall, HELP_SECONDS),
    ]
