"""How long commands and imports take to start, each in a process of its own.

    pytest benchmarks/bench_start.py --benchmark-enable --benchmark-only

Seconds on the wall, the median of three, the files in the system's cache. Of the parts' imports
nearly all is torch and TorchRL, which are imported first for comparison.
"""

from __future__ import annotations

import pytest

from benchmarks.parts import processes

COMMANDS = {
    "train.py --help": processes.HELP,
    "evaluate --help": ("-m", "bbq_torchrl.evaluate", "--help"),
    "compose a configuration": (
        "-c",
        "from bbq_torchrl.cli.store import compose; compose(['agent=dqn'])",
    ),
    **{f"import {name}": ("-c", f"import {name}") for name in ("torch", "torchrl.objectives")},
    **{f"import {name}": ("-c", f"import {name}") for name in processes.IMPORTS},
}


@pytest.mark.parametrize("command", COMMANDS)
def test_start(benchmark, command):
    if benchmark.disabled and command != "train.py --help":
        pytest.skip("the same code as for train.py --help, and seconds of imports")
    used = []
    benchmark.pedantic(
        lambda: used.append(processes.python(*COMMANDS[command])),
        rounds=3,
        warmup_rounds=0 if benchmark.disabled else 1,
    )
    cpu = sorted(one.cpu for one in used)[len(used) // 2]
    benchmark.extra_info |= {"processor_seconds": cpu, "peak_mb": used[-1].peak_bytes / 1e6}
