"""Checks and times training on a GPU, in at most eight minutes.

    python benchmarks/gpu.py                 on cuda; writes results/gpu.csv
    python benchmarks/gpu.py --parts same host
    python benchmarks/gpu.py --device cpu --tiny --file gpu.csv    checks the benchmark itself

To check that training on the device equals training on the CPU, both draw all random numbers on the
CPU. Parts beyond the time limit are left out and listed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python benchmarks/gpu.py` finds its own packages

import torch  # noqa: E402

from benchmarks.parts import on_device  # noqa: E402
from benchmarks.parts.rows import Row, as_table, keep  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Sequence

PARTS = {
    "same": on_device.same_training,
    "host": on_device.host_waits,
    "turns": on_device.turns,
    "run": on_device.whole_run,
    "updates": on_device.updates,
}
"""Name -> the function that measures it; the slowest comes last."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures the given parts, by default all, prints and saves them. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=[*PARTS])
    parser.add_argument("--device", default="cuda", help="default: cuda")
    parser.add_argument("--minutes", type=float, default=8.0, help="default: 8")
    parser.add_argument("--tiny", action="store_true", help="sizes that only test the benchmark")
    parser.add_argument("--file", type=Path, default=ROOT / "results" / "gpu.csv")
    chosen = parser.parse_args(arguments)
    is_gpu = torch.device(chosen.device).type == "cuda"
    if is_gpu and not torch.cuda.is_available():
        parser.error(f"--device must be there, got {chosen.device}: torch finds no CUDA device")
    card = torch.cuda.get_device_name(chosen.device) if is_gpu else "cpu"
    sizes = on_device.TINY if chosen.tiny else on_device.FULL
    end, rows = monotonic() + 60 * chosen.minutes, list[Row]()
    for part in chosen.parts:
        if part == "host" and not is_gpu:
            sys.stderr.write("left out: host, which only a CUDA device tells\n")
            continue
        sys.stderr.write(f"measuring: {part}\n")
        for row in PARTS[part](chosen.device, sizes):
            rows.append(row)
            keep(chosen.file, card, rows)
            if monotonic() > end:
                sys.stderr.write(f"out of time after: {row.what}\n")
                break
        if monotonic() > end:
            break
    print(as_table(rows))
    return int(any(row.reached is False for row in rows))


if __name__ == "__main__":
    sys.exit(main())
