"""Weight draws of several passes with one and the same noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.bayes.context import Context
from bbq_torchrl.bayes.noise_pool import noise_pool

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from bbq_torchrl.bayes.posterior import GaussianPosterior

__all__ = ["noise_for", "shared_noise"]


class shared_noise(Context):
    """Makes the weight draws inside of each ``with`` block on this object use the same noise.

    The n-th draw of a posterior in a block uses the noise of its n-th draw in the first block
    that came so far: with other parameters μ', ρ' in place the weights there are μ' + σ'·ε
    with the very ε of the first ones. The noise is kept, not copied, for as long as the object
    lives.

    Raises:
        ValueError: at a draw whose shape is not that of the noise it is to share.

    Example:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, shared_noise
        >>> net, x, noise = BayesMLP(3, 2), torch.ones(3), shared_noise()
        >>> with noise:
        ...     first = net(x, "draw")
        >>> with noise:
        ...     second = net(x, "draw")
        >>> torch.equal(first, second), torch.equal(first, net(x, "draw"))
        (True, False)
    """

    def __init__(self) -> None:
        self._drawn: dict[GaussianPosterior, list[Tensor]] = {}
        self._used: dict[GaussianPosterior, int] = {}

    def next(self, posterior: GaussianPosterior, shape: torch.Size) -> tuple[Tensor, bool]:
        """Returns the noise of this block's next draw, and whether it holds numbers yet."""
        drawn = self._drawn.setdefault(posterior, [])
        number = self._used.get(posterior, 0)
        self._used[posterior] = number + 1
        if number == len(drawn):
            noise, is_filled = _new_noise(posterior, shape)
            drawn.append(noise)
            return noise, is_filled
        if drawn[number].shape != shape:
            raise ValueError(
                f"a draw of shape {list(shape)} cannot share noise of shape "
                f"{list(drawn[number].shape)}"
            )
        return drawn[number], True

    def __enter__(self) -> shared_noise:
        self._used = {}
        return super().__enter__()


def noise_for(posterior: GaussianPosterior, shape: torch.Size) -> tuple[Tensor, bool]:
    """Returns a tensor for the noise of a draw, and whether it holds numbers already.

    Outside of :class:`shared_noise` and :class:`~bbq_torchrl.bayes.noise_pool` it is always an
    empty one.

    Args:
        posterior: what is drawn from.
        shape: of the draw.
    """
    noise = shared_noise.active()
    return _new_noise(posterior, shape) if noise is None else noise.next(posterior, shape)


def _new_noise(posterior: GaussianPosterior, shape: torch.Size) -> tuple[Tensor, bool]:
    """Returns a tensor for noise that no draw has used, and whether it holds numbers already."""
    pool = noise_pool.active()
    noise = None if pool is None else pool.window(posterior, shape)
    if noise is None:
        return posterior.mu.new_empty(shape), False
    return noise, True
