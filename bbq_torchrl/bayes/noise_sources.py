"""Where the noise of weight draws comes from: a pool for many batches, or an earlier draw."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import torch

from bbq_torchrl.bayes.noise import fill_normal_, is_transformed

if TYPE_CHECKING:
    from torch import Tensor

    from bbq_torchrl.bayes.posterior import GaussianPosterior

__all__ = ["NoisePool", "NoiseSource", "SharedNoise"]

_DRAWS = 8
_PLACES = 512  # drawn at a time: one random number alone costs as much as hundreds


class NoiseSource(Protocol):
    """What a :class:`weight_scope` takes as ``noise``."""

    def normal(self, posterior: GaussianPosterior, shape: torch.Size) -> Tensor:
        """Returns standard normal numbers for a draw from the posterior.

        Args:
            posterior: what is drawn from.
            shape: of the draw, [*replicas, *rows, P].
        """


class NoisePool:
    """Noise for many batches: each draw takes a window of numbers that are made once.

    Normal numbers for all weights are a good part of a Bayes-by-Backprop update on a CPU. Here
    every replica of a network has a pool of its own, ``draws`` times as many numbers as it has
    weights, made at the first draw and kept until :meth:`clear`; the noise of a draw is a window
    of it at a random place (the noise table of Salimans et al. 2017, "Evolution Strategies as a
    Scalable Alternative to Reinforcement Learning"). Each draw is of independent standard normal
    numbers; two draws may share some of them, at different weights. Networks share none.

    Draws with more dimensions than the replicas (one for each dialogue, say) have new noise, and so
    have draws on devices other than the CPU, where noise costs little.

    Args:
        draws: size of a pool, in draws. Defaults to 8.

    Raises:
        ValueError: if ``draws`` is less than 2.

    Example:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, weight_scope
        >>> from bbq_torchrl.bayes.noise_sources import NoisePool
        >>> net, x = BayesMLP(3, 2), torch.ones(3)
        >>> with weight_scope("draw", noise=NoisePool()):
        ...     torch.equal(net(x), net(x))
        False
    """

    def __init__(self, draws: int = _DRAWS) -> None:
        if draws < 2:
            raise ValueError(f"draws must be at least 2, got {draws}")
        self.draws = draws
        self._pools: dict[GaussianPosterior, Tensor] = {}
        self._places: dict[GaussianPosterior, list[int]] = {}

    def clear(self) -> None:
        """Drops the pools; the next draw makes new ones, from torch's global generator."""
        self._pools.clear()
        self._places.clear()

    def normal(self, posterior: GaussianPosterior, shape: torch.Size) -> Tensor:
        """Returns the noise of a draw: a window of the pool, or new noise; see the class."""
        mu = posterior.mu
        if shape != mu.shape or mu.device.type != "cpu" or is_transformed():
            return posterior.new_noise(shape)
        count = shape[-1]
        pool = self._pools.get(posterior)
        if pool is None:
            pool = fill_normal_(mu.new_empty((*shape[:-1], self.draws * count)))
            self._pools[posterior], self._places[posterior] = pool, []
        places = self._places[posterior]
        if not places:
            places += torch.randint((self.draws - 1) * count + 1, (_PLACES,)).tolist()
        return pool.narrow(-1, places.pop(), count)


class SharedNoise:
    """Weight draws of several passes with one and the same noise.

    The n-th draw from a posterior with this source has the noise of the n-th draw with the source
    that it was made :meth:`again` of: with other parameters μ', ρ' in place the weights there are
    μ' + σ'·ε with the very ε of the first ones. The noise is kept for as long as the object lives.

    Args:
        source: where noise that no draw has used comes from. Defaults to None, torch's generator.

    Raises:
        ValueError: at a draw whose shape is not that of the noise it is to share.

    Example:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, weight_scope
        >>> from bbq_torchrl.bayes.noise_sources import SharedNoise
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
        self._drawn: dict[GaussianPosterior, list[Tensor]] = {}
        self._used: dict[GaussianPosterior, int] = {}

    def again(self) -> SharedNoise:
        """Returns a source that begins with the first noise again and shares what follows."""
        other = SharedNoise(self._source)
        other._drawn = self._drawn
        return other

    def normal(self, posterior: GaussianPosterior, shape: torch.Size) -> Tensor:
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
