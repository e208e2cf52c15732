"""Which weights a network with uncertain weights uses: a draw, the mean, or given ones.

A layer of this package looks, in this order, at the ``weights`` and ``mode`` it is called
with, at the innermost :class:`given_weights` and :class:`set_weight_mode` around the call, and
at TorchRL's :func:`~torchrl.envs.utils.exploration_type`. The two context managers reach the
layers of a network whatever stands around them (``nn.Sequential``, a TensorDict module, a
functional call), so a policy or a loss needs no access to the layers themselves.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Literal, get_args

from torchrl.envs.utils import ExplorationType, exploration_type

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

    from torch import Tensor, nn

__all__ = ["WeightMode", "given_weights", "resolve_weight_mode", "set_weight_mode", "weight_mode"]

WeightMode = Literal["draw", "local", "mean"]
WEIGHT_MODES: tuple[str, ...] = get_args(WeightMode)


class _Settings(threading.local):
    mode: WeightMode | None = None
    weights: Mapping[Any, Tensor] | None = None


_settings = _Settings()


def check_weight_mode(mode: str) -> None:
    """Raises ValueError unless ``mode`` is one of "draw", "local" and "mean"."""
    if mode not in WEIGHT_MODES:
        raise ValueError(f"mode must be one of {list(WEIGHT_MODES)}, got {mode!r}")


def weight_mode() -> WeightMode | None:
    """Returns the mode set by the innermost :class:`set_weight_mode`, None outside of one."""
    return _settings.mode


def resolve_weight_mode(mode: WeightMode | None) -> WeightMode:
    """Returns the mode that a call with this argument uses.

    Without an argument and outside of :class:`set_weight_mode` it follows TorchRL's exploration
    type: RANDOM is "draw"; DETERMINISTIC, MEAN, MODE and None (outside of any context, as
    TorchRL's NoisyLinear has it) are "mean".

    Args:
        mode: an explicit choice, or None.

    Raises:
        ValueError: for any other string.
    """
    if mode is not None:
        check_weight_mode(mode)
        return mode
    if _settings.mode is not None:
        return _settings.mode
    return "draw" if exploration_type() is ExplorationType.RANDOM else "mean"


def weights_given_to(module: nn.Module) -> Tensor | None:
    """Returns the weights that the innermost :class:`given_weights` has for ``module``."""
    return None if _settings.weights is None else _settings.weights.get(module)


class set_weight_mode:
    """Sets the weight mode of every layer that runs inside of the context.

    - ``"draw"``: one draw of all weights for the call, shared by its rows (dropout: a mask).
    - ``"local"``: local reparameterisation, independent noise for each row and unit (Kingma,
      Salimans, Welling 2015); exact for one input per draw.
    - ``"mean"``: the posterior mean (dropout: off).

    Args:
        mode: "draw", "local", "mean", or None to follow the exploration type again.

    Raises:
        ValueError: for any other string.

    Example:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> net, x = BayesMLP(3, 2), torch.ones(3)
        >>> with set_weight_mode("mean"):
        ...     net(x)
        tensor([0., 0.], grad_fn=...)
        >>> with set_weight_mode("draw"):
        ...     bool((net(x) == net(x)).any())
        False
    """

    def __init__(self, mode: WeightMode | None) -> None:
        if mode is not None:
            check_weight_mode(mode)
        self.mode = mode

    def __enter__(self) -> None:
        self._outer = _settings.mode
        _settings.mode = self.mode

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        _settings.mode = self._outer


class given_weights:
    """Makes the layers inside of the context use these weights, whatever the mode.

    Args:
        weights: for each module the flat weights to use, shape [*stack, *rows, P] as
            :meth:`BayesMLP.draw_weights` returns them. Modules that are not in it are not
            affected.

    Example:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> net = BayesMLP(3, 2)
        >>> w = net.draw_weights((4,))  # weights of its own for each of four rows
        >>> with given_weights({net: w}):
        ...     q = net(torch.ones(4, 3))
        >>> q.shape, bool((q[0] == q[1]).any())
        (torch.Size([4, 2]), False)
    """

    def __init__(self, weights: Mapping[Any, Tensor]) -> None:
        self.weights = weights

    def __enter__(self) -> None:
        self._outer = _settings.weights
        _settings.weights = self.weights

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        _settings.weights = self._outer
