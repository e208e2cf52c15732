"""Random numbers for many batches, weight noise and dropout, out of one pool."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.bayes.context import Context
from bbq_torchrl.bayes.noise import fill_kept_, fill_normal_

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from torch import Tensor

    from bbq_torchrl.bayes.posterior import GaussianPosterior

__all__ = ["noise_pool"]

_DRAWS = 8
_PLACES = 512  # drawn at a time: one random number alone costs as much as hundreds


class noise_pool(Context):
    """Makes weight draws and dropout inside of each ``with`` block take their noise from a pool.

    Normal numbers for all weights are a fifth of the time of a Bayes-by-Backprop update on a CPU.
    Here every network of a stack has a pool of its own, ``draws`` times as many numbers as it has
    weights, made at the first draw and kept until :meth:`clear`; the noise of a draw is a window
    of it at a random place (the noise table of Salimans et al. 2017, "Evolution Strategies as a
    Scalable Alternative to Reinforcement Learning"). Each draw is of independent standard normal
    numbers; two draws may share some of them, at different weights. Networks share none.
    Dropout (of :class:`~bbq_torchrl.networks.FlatMLP`), a tenth of a DQN update, takes what
    it keeps from a pool of as many batches in the same way.

    Draws with more dimensions than the stack (one for each dialogue, say) are not concerned, nor
    are devices other than the CPU, where noise costs little.

    Args:
        draws: size of a pool, in draws. Defaults to 8.

    Raises:
        ValueError: if ``draws`` is less than 2.

    Example:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, noise_pool
        >>> net, x, pool = BayesMLP(3, 2), torch.ones(3), noise_pool()
        >>> with pool:
        ...     torch.equal(net(x, "draw"), net(x, "draw"))
        False
    """

    def __init__(self, draws: int = _DRAWS) -> None:
        if draws < 2:
            raise ValueError(f"draws must be at least 2, got {draws}")
        self.draws = draws
        self._pools: dict[Hashable, tuple[Tensor, list[int]]] = {}

    def clear(self) -> None:
        """Drops the pools; the next draw makes new ones, from torch's global generator."""
        self._pools.clear()

    def window(self, posterior: GaussianPosterior, shape: torch.Size) -> Tensor | None:
        """Returns the noise of a draw, a view [*stack, P], or None where this is not its job."""
        mu = posterior.mu
        if shape != mu.shape or mu.device.type != "cpu":
            return None
        return self._window(posterior, mu, shape[:-1], shape[-1], fill_normal_)

    def kept_units(self, x: Tensor, units: int, dropout: float) -> Tensor | None:
        """Returns 1 for the units that dropout keeps, else 0, a view; None off the CPU.

        Args:
            x: a batch of one network, [rows, *], or of a stack of them, [networks, rows, *].
            units: of the network.
            dropout: probability with which a unit is dropped.

        Returns:
            shape [rows, units] or [networks, rows, units].
        """
        if x.device.type != "cpu":
            return None
        *networks, rows, _ = x.shape

        def fill_(pool: Tensor) -> Tensor:
            return fill_kept_(pool, dropout)

        key = (*networks, rows, units, dropout, x.dtype)
        return self._window(key, x, networks, rows * units, fill_).unflatten(-1, (rows, units))

    def _window(
        self,
        key: Hashable,
        like: Tensor,
        lead: Sequence[int],
        count: int,
        fill_: Callable[[Tensor], Tensor],
    ) -> Tensor:
        """Returns a view [*lead, count] at a random place of a pool, which is made if need be."""
        found = self._pools.get(key)
        if found is None:
            found = self._pools[key] = fill_(like.new_empty((*lead, self.draws * count))), []
        pool, places = found
        if not places:
            places += torch.randint((self.draws - 1) * count + 1, (_PLACES,)).tolist()
        return pool.narrow(-1, places.pop(), count)
