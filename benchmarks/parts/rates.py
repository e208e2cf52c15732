"""What the machine can do: matrix products, copies, random numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.bayes.noise import fill_normal_
from benchmarks.parts.work import BATCH, LAYERS, PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.parts.timing import Timer

BLOCKS = 15
COPIES = {"L2": 256 * 1024, "L3": 4 * 1024**2, "DRAM": 256 * 1024**2}
"""Cache -> bytes of the source; the target is as large."""
LARGE = 1024


def rates(timer: Timer, seconds: float = 0.02) -> dict[str, dict[str, float]]:
    """Measures the machine on one thread, each figure the best of short blocks.

    Args:
        timer: the clock.
        seconds: about as long as a block takes.

    Returns:
        operations a second by shape of the matrix product, bytes a second (read and written) by
        the cache that holds them, numbers a second by what is done to them.
    """

    def best(work: Callable[[], object]) -> float:
        work()
        repeats = max(1, int(seconds / max(timer.time(work), 1e-7)))
        return min(
            timer.time(lambda: [work() for _ in range(repeats)]) / repeats for _ in range(BLOCKS)
        )

    products = {}
    for name, (rows, inner, columns) in _shapes().items():
        left, right = torch.randn(rows, inner), torch.randn(inner, columns)
        bias, out = torch.randn(columns), torch.empty(rows, columns)
        took = best(lambda b=bias, x=left, y=right, o=out: torch.addmm(b, x, y, out=o))
        products[name] = 2.0 * rows * inner * columns / took
    copies = {}
    for name, size in COPIES.items():
        source, target = (torch.zeros(size // 4) for _ in range(2))
        copies[name] = 2.0 * size / best(lambda s=source, t=target: t.copy_(s))
    vector, other = torch.rand(PARAMETERS), torch.empty(PARAMETERS)
    numbers = {
        "normals": best(lambda: fill_normal_(vector)),
        "normals, by torch": best(vector.normal_),
        "uniforms": best(vector.uniform_),
        "exponentials": best(lambda: torch.exp(vector, out=other)),
        "softplus": best(lambda: torch.ops.aten.softplus.out(vector, 1, 20, out=other)),
        "fused Adam": best(_adam()),
    }
    return {
        "operations per second": products,
        "bytes per second": copies,
        "numbers per second": {name: PARAMETERS / took for name, took in numbers.items()},
    }


def _shapes() -> dict[str, tuple[int, int, int]]:
    """Returns rows, inner dimension and columns of an update's products and of a large one."""
    shapes = {}
    for inputs, outputs in LAYERS:
        shapes[f"forward {BATCH}x{inputs} by {inputs}x{outputs}"] = (BATCH, inputs, outputs)
    for inputs, outputs in LAYERS:
        shapes[f"gradient {inputs}x{BATCH} by {BATCH}x{outputs}"] = (inputs, BATCH, outputs)
    return {**shapes, f"large {LARGE}x{LARGE} by {LARGE}x{LARGE}": (LARGE, LARGE, LARGE)}


def _adam() -> Callable[[], object]:
    parameter = torch.nn.Parameter(torch.randn(PARAMETERS))
    parameter.grad = torch.randn(PARAMETERS)
    return torch.optim.Adam([parameter], lr=1e-3, fused=True).step
