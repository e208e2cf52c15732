"""Standard normal noise for whole networks at a time, more than twice as fast as ``normal_``.

A weight draw a mini-batch needs as many normal numbers as the network has weights (145 k for
268-256-256-39), and torch's generator on a CPU makes them one by one: .5 ms, as much as all
matrix products of the update. A draw here takes one seed from torch's generator (so that
``torch.manual_seed`` and saved generator states cover it), lets NumPy's SFC64 fill a block of
random bits, and looks up 16 of them a number in a table of the normal distribution.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from torch import Tensor

__all__ = ["fill_kept_", "fill_normal_", "is_transformed"]

_LEVELS = 2**16  # 16 random bits a number
_WORTHWHILE = 2**13  # below this many numbers torch's own generator is as fast


def is_transformed() -> bool:
    """Returns whether torch.compile traces the caller, or a transform of torch.func runs it.

    What fills memory by hand, or has a gradient written by hand that knows no ``vmap``, has to
    leave the work to torch's own operations there.
    """
    return torch.compiler.is_compiling() or bool(torch._C._are_functorch_transforms_active())


@cache
def _table() -> Tensor:
    """Returns 65,536 equally likely values that stand for N(0, 1), float32.

    Each one is the root mean square of its 1/65,536 share of the distribution, so that the mean
    is 0 and the variance 1; the fourth moment is 2.9999 (of 3), the greatest value 4.39.
    """
    edge = torch.special.ndtri(torch.arange(_LEVELS // 2 + 1, dtype=torch.double) / _LEVELS)
    # the mean of z² between a and b is 1 + (a φ(a) - b φ(b)) / (Φ(b) - Φ(a))
    slope = edge.nan_to_num() * (edge.square() / -2).exp() / (2 * torch.pi) ** 0.5
    slope[0] = 0.0
    lower = -(1 + _LEVELS * (slope[:-1] - slope[1:])).sqrt()
    return torch.cat([lower, -lower.flip(0)]).float()


def fill_normal_(out: Tensor) -> Tensor:
    """Fills ``out`` with standard normal numbers in place and returns it.

    On a CPU, in float32 and for more than a few thousand numbers these are drawn from 65,536
    equally likely values with mean 0 and variance 1, none beyond 4.39; else by ``normal_``.

    Args:
        out: any shape.

    Example:
        >>> import torch
        >>> noise = fill_normal_(torch.empty(5, 100_000))
        >>> bool(abs(noise.mean()) < 0.01), bool(abs(noise.var() - 1) < 0.01)
        (True, True)
    """
    count = out.numel()
    if (
        out.device.type != "cpu"
        or out.dtype != torch.float32
        or count < _WORTHWHILE
        or not out.is_contiguous()
    ):
        return out.normal_()
    seed = int(torch.randint(2**63 - 1, ()))
    words = np.random.SFC64(seed).random_raw(-(-count // 4))
    index = torch.from_numpy(words.view(np.uint16))[:count].to(torch.int32)
    torch.index_select(_table(), 0, index, out=out.view(-1))
    return out


def fill_kept_(out: Tensor, dropout: float) -> Tensor:
    """Fills ``out`` with 1 with probability 1 - dropout, else 0, in place and returns it.

    16 random bits decide on a number, four numbers to one of torch's generator, which makes a
    uniform float for each in four times the time; so dropout is rounded to a multiple of 2⁻¹⁶.

    Args:
        out: any shape.
        dropout: from 0 to below 1.

    Example:
        >>> import torch
        >>> bool(abs(fill_kept_(torch.empty(5, 100_000), 0.2).mean() - 0.8) < 0.01)
        True
    """
    if is_transformed():
        return (torch.rand(out.shape, device=out.device) >= dropout).to(out.dtype)
    count = out.numel()
    bits = torch.empty(-(-count // 4), dtype=torch.int64, device=out.device)
    uniform = bits.random_(-(2**63), None).view(torch.int16)[:count].view(out.shape)
    least = min(round(dropout * 2**16), 2**16 - 1) - 2**15
    return torch.ge(uniform, least, out=out)
