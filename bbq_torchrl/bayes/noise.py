"""The noise of weight draws: fast normal numbers, a pool of them, and noise shared by passes.

A weight draw a mini-batch needs as many normal numbers as the network has weights (145 k for
268-256-256-39), and torch's generator on a CPU makes them one by one: .5 ms, as much as all
matrix products of the update. A draw here takes one seed from torch's generator (so that
``torch.manual_seed`` and saved generator states cover it), lets NumPy's SFC64 fill a block of
random bits, and looks up 16 of them a number in a table of the normal distribution.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from torch import Tensor

from bbq_torchrl.checks import at_least, check

if TYPE_CHECKING:
    from collections.abc import Sequence

_LEVELS = 2**16  # 16 random bits a number
_WORTHWHILE = 2**13  # below this many numbers torch's own generator is as fast
_DRAWS = 8
_PLACES = 512  # drawn at a time: one random number alone costs as much as hundreds


def is_transformed() -> bool:
    """Returns whether torch.compile traces the caller, or a transform of torch.func runs it.

    What fills memory by hand, or has a gradient written by hand, has to leave the work to torch's
    own operations there.
    """
    # A custom Function with a setup_context could run under torch.func itself. Outside of it each
    # apply then binds its arguments by inspect.signature, and what is saved has to be an output:
    # for draw, network and loss together that makes an update of BBQN-MAP 8 % slower.
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

    Examples:
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

    Examples:
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


class Drawn(Protocol):
    """A posterior that weights are drawn from, as far as its noise is concerned."""

    @property
    def mu(self) -> Tensor:
        """The means, [*replicas, P]."""

    def new_noise(self, shape: Sequence[int]) -> Tensor:
        """Returns standard normal numbers from torch's generator."""


class NoiseSource(Protocol):
    """The noise of weight draws, as :func:`weight_scope` takes it."""

    def normal(self, posterior: Drawn, shape: torch.Size) -> Tensor:
        """Returns standard normal numbers for a draw from the posterior.

        Args:
            posterior: draws are from it.
            shape: of the draw, [*replicas, *rows, P].
        """


class NoisePool:
    """Noise for many batches: each draw takes a window of numbers that are made once.

    Normal numbers for all weights are a good part of a Bayes-by-Backprop update on a CPU. Here
    every replica of a network has a separate pool, ``draws`` times as many numbers as it has
    weights, made at the first draw from torch's global generator; the noise of a draw is a window
    of it at a random place (the noise table of Salimans et al. 2017, "Evolution Strategies as a
    Scalable Alternative to Reinforcement Learning"). Each draw is of independent standard normal
    numbers; two draws may share some of them, at different weights. Networks share none.

    Draws with more dimensions than the replicas (one for each episode, say) have new noise, and so
    have draws on devices other than the CPU, where noise costs little.

    Args:
        draws: size of a pool, in draws. Defaults to 8.

    Raises:
        ValueError: if ``draws`` is less than 2.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, weight_scope
        >>> from bbq_torchrl.bayes.noise import NoisePool
        >>> net, x = BayesMLP(3, 2), torch.ones(3)
        >>> with weight_scope("draw", noise=NoisePool()):
        ...     torch.equal(net(x), net(x))
        False
    """

    def __init__(self, draws: int = _DRAWS) -> None:
        check("draws", draws, at_least(2))
        self.draws = draws
        # numbers, and places that were drawn for windows to come
        self._pools: dict[Drawn, tuple[Tensor, list[int]]] = {}

    def normal(self, posterior: Drawn, shape: torch.Size) -> Tensor:
        """Returns the noise of a draw: a window of the pool, or new noise; see the class."""
        mu = posterior.mu
        if shape != mu.shape or mu.device.type != "cpu" or is_transformed():
            return posterior.new_noise(shape)
        count = shape[-1]
        if posterior not in self._pools:
            numbers = fill_normal_(mu.new_empty((*shape[:-1], self.draws * count)))
            self._pools[posterior] = (numbers, [])
        numbers, places = self._pools[posterior]
        if not places:
            places += torch.randint((self.draws - 1) * count + 1, (_PLACES,)).tolist()
        return numbers.narrow(-1, places.pop(), count)


class SharedNoise:
    """The same noise for the weight draws of several passes.

    The n-th draw from a posterior with this source has the noise of the n-th draw with the source
    that it was made :meth:`again` of: with other parameters μ', ρ' in place the weights there are
    μ' + σ'·ε with the very ε of the first ones. The noise is kept for as long as the object lives.

    Args:
        source: where noise that no draw has used comes from. Defaults to None, torch's generator.

    Raises:
        ValueError: at a draw whose shape is not that of the noise it is to share.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, weight_scope
        >>> from bbq_torchrl.bayes.noise import SharedNoise
        >>> net, x, noise = BayesMLP(3, 2), torch.ones(3), SharedNoise()
        >>> with weight_scope("draw", noise=noise):
        ...     first = net(x)
        >>> with weight_scope("draw", noise=noise.again()):
        ...     second = net(x)
        >>> torch.equal(first, second), torch.equal(first, net(x, "draw"))
        (True, False)
    """

    def __init__(self, source: NoiseSource | None = None) -> None:
        self._source = source
        self._drawn: dict[Drawn, list[Tensor]] = {}
        self._used: dict[Drawn, int] = {}

    def again(self) -> SharedNoise:
        """Returns a source that begins with the first noise again and shares what follows."""
        other = SharedNoise(self._source)
        other._drawn = self._drawn
        return other

    def normal(self, posterior: Drawn, shape: torch.Size) -> Tensor:
        """Returns the noise of the next draw."""
        drawn = self._drawn.setdefault(posterior, [])
        number = self._used.get(posterior, 0)
        self._used[posterior] = number + 1
        if number == len(drawn):
            source = self._source
            new = posterior.new_noise(shape) if source is None else source.normal(posterior, shape)
            drawn.append(new)
        if drawn[number].shape != shape:
            raise ValueError(
                f"a draw of shape {list(shape)} cannot share noise of shape "
                f"{list(drawn[number].shape)}"
            )
        return drawn[number]
