"""The noise of weight draws: a fast normal generator, a noise pool, and noise shared by passes.

The weight draw of a mini-batch needs one normal number per weight (145 k for 268-256-256-39).
torch's generator makes them one by one on a CPU, in 0.5 ms, as much as all matrix products of the
update take. Here a draw takes one seed from torch's generator, so that ``torch.manual_seed`` and
saved generator states cover it. NumPy's SFC64 then fills a block with random bits, and every 16
bits index a table of the normal distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

_LEVELS = 2**16  # 16 random bits per number
_MIN_COUNT = 2**13  # below this count torch's generator is as fast
_DRAWS = 8
_OFFSETS = 512  # drawn at once: a single random number costs as much as hundreds


def is_transformed() -> bool:
    """Returns whether torch.compile traces the caller, or a torch.func transform runs it.

    In-place fills and hand-written gradients must then leave the work to torch's operations.
    """
    # A custom Function with a setup_context could run under torch.func. Outside of it, however,
    # each apply would bind its arguments by inspect.signature and could only save outputs. With
    # draw, network and loss written that way, an update of BBQN-MAP is 8 % slower.
    return torch.compiler.is_compiling() or bool(torch._C._are_functorch_transforms_active())


@cache
def _table() -> Tensor:
    """Returns 65,536 equally likely values that approximate N(0, 1), float32.

    Each is the root mean square of its 1/65,536 share of the distribution, so the mean is 0 and
    the variance 1. The fourth moment is 2.9999 (exact: 3), and the largest value is 4.39.
    """
    edge = torch.special.ndtri(torch.arange(_LEVELS // 2 + 1, dtype=torch.double) / _LEVELS)
    # the mean of z² between a and b is 1 + (a φ(a) - b φ(b)) / (Φ(b) - Φ(a))
    slope = edge.nan_to_num() * (edge.square() / -2).exp() / (2 * torch.pi) ** 0.5
    slope[0] = 0.0
    lower = -(1 + _LEVELS * (slope[:-1] - slope[1:])).sqrt()
    return torch.cat([lower, -lower.flip(0)]).float()


def fill_normal_(out: Tensor) -> Tensor:
    """Fills ``out`` with standard normal numbers in place and returns it.

    On a CPU, in float32 and from a few thousand numbers on, they are drawn from 65,536 equally
    likely values with mean 0, variance 1 and no magnitude above 4.39; otherwise by ``normal_``.

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
        or count < _MIN_COUNT
        or not out.is_contiguous()
    ):
        return out.normal_()
    seed = int(torch.randint(2**63 - 1, ()))
    words = np.random.SFC64(seed).random_raw(-(-count // 4))
    index = torch.from_numpy(words.view(np.uint16))[:count].to(torch.int32)
    torch.index_select(_table(), 0, index, out=out.view(-1))
    return out


def fill_dropout_mask_(out: Tensor, dropout: float) -> Tensor:
    """Fills ``out`` in place with 1 (probability 1 - dropout) or 0 and returns it.

    Each element takes 16 random bits, a quarter of one number of torch's generator; a uniform float
    for each would take four times as long. So dropout is rounded to a multiple of 2⁻¹⁶.

    Args:
        out: any shape.
        dropout: the dropout probability, in [0, 1).

    Examples:
        >>> import torch
        >>> bool(abs(fill_dropout_mask_(torch.empty(5, 100_000), 0.2).mean() - 0.8) < 0.01)
        True
    """
    if is_transformed():
        return (torch.rand(out.shape, device=out.device) >= dropout).to(out.dtype)
    count = out.numel()
    bits = torch.empty(-(-count // 4), dtype=torch.int64, device=out.device)
    uniform = bits.random_(-(2**63), None).view(torch.int16)[:count].view(out.shape)
    least = min(round(dropout * 2**16), 2**16 - 1) - 2**15
    return torch.ge(uniform, least, out=out)


class NoisyPosterior(Protocol):
    """The members of a posterior that a noise source uses."""

    @property
    def mu(self) -> Tensor:
        """The means, [*replicas, P]."""

    def new_noise(self, shape: Sequence[int]) -> Tensor:
        """Returns standard normal numbers from torch's generator."""


class NoiseSource(Protocol):
    """The noise of weight draws, as :func:`weight_scope` takes it."""

    def normal(self, posterior: NoisyPosterior, shape: torch.Size) -> Tensor:
        """Returns standard normal numbers for a draw from the posterior.

        Args:
            posterior: the posterior drawn from.
            shape: the shape of the draw, [*replicas, *rows, P].
        """


class NoisePool:
    """A noise pool for many batches: each draw takes a window of numbers generated once.

    Normal numbers for all weights take a large part of a Bayes-by-Backprop update on a CPU. Here
    every replica of a network has a separate pool of ``draws`` times as many numbers as it has
    weights, filled at the first draw from torch's global generator. The noise of a draw is a window
    of the pool at a random offset (the noise table of Salimans et al. 2017, "Evolution Strategies
    as a Scalable Alternative to Reinforcement Learning"). The numbers of a draw are independent and
    standard normal. Two draws may share some of them, at different weights. Networks share no
    numbers.

    Draws with more dimensions than the replicas (such as one for each episode) get new noise, as do
    draws on devices other than the CPU, where noise costs little.

    Args:
        draws: the size of a pool, in draws, at least 2. Defaults to 8.

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
        self.draws = draws
        # the numbers, and offsets of the next windows
        self._pools: dict[NoisyPosterior, tuple[Tensor, list[int]]] = {}

    def normal(self, posterior: NoisyPosterior, shape: torch.Size) -> Tensor:
        """Returns the noise of a draw: a window of the pool, or new noise; see the class."""
        mu = posterior.mu
        if shape != mu.shape or mu.device.type != "cpu" or is_transformed():
            return posterior.new_noise(shape)
        count = shape[-1]
        if posterior not in self._pools:
            numbers = fill_normal_(mu.new_empty((*shape[:-1], self.draws * count)))
            self._pools[posterior] = (numbers, [])
        numbers, offsets = self._pools[posterior]
        if not offsets:
            offsets += torch.randint((self.draws - 1) * count + 1, (_OFFSETS,)).tolist()
        return numbers.narrow(-1, offsets.pop(), count)


class SharedNoise:
    """The same noise for the weight draws of several passes.

    A source returned by :meth:`again` replays the noise: its n-th draw from a posterior has the
    noise ε of the n-th draw with the original. With other parameters μ', ρ' the weights are then
    μ' + σ'·ε with the same ε. The noise is stored for the lifetime of the object.

    Args:
        source: the source of new noise. Defaults to None, torch's generator.

    Raises:
        ValueError: at a draw whose shape differs from that of the shared noise.

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
        self._drawn: dict[NoisyPosterior, list[Tensor]] = {}
        self._used: dict[NoisyPosterior, int] = {}

    def again(self) -> SharedNoise:
        """Returns a source that replays the noise from the first draw on and shares new noise."""
        other = SharedNoise(self._source)
        other._drawn = self._drawn
        return other

    def normal(self, posterior: NoisyPosterior, shape: torch.Size) -> Tensor:
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
