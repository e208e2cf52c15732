"""The weight scope, which sets the weights, noise and KL of the layers called inside it.

A layer uses the weights passed to its call, or those of the surrounding :func:`weight_scope`.
Without either it uses the mode passed to its call, the scope's, or the one that TorchRL's
exploration type implies. So a policy or a loss controls the layers of a network without access to
them, whatever wraps them (``nn.Sequential``, a TensorDict module, a functional call).
"""

from __future__ import annotations

import threading
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from tensordict.nn.probabilistic import InteractionType, interaction_type
from torch import Tensor

from bbq_torchrl.bayes.noise import NoiseSource
from bbq_torchrl.bayes.weight_draw import KL_KIND, KLKind
from bbq_torchrl.settings import check, one_of

WeightMode = Literal["draw", "local", "mean"]
WEIGHT_MODE = one_of(*get_args(WeightMode))


class KLSum:
    """The sum of the KL from the prior over all posteriors in use, each counted once.

    A posterior that draws its weights adds its KL along with the draw and shares σ with it.

    Args:
        kind: "closed", or "sampled" (log q(w) - log p(w) at the draw; needs layers that draw
            their weights).
        cache: closed KL values by posterior, which the caller passes from one sum to the next. A
            posterior that is drawn from reports its cached value with the current gradient; a
            missing value is added. Defaults to None, no cache.

    Raises:
        ValueError: for an unknown kind; at a draw, for a cache with kind="sampled".
    """

    def __init__(
        self, kind: KLKind = "closed", cache: dict[Hashable, Tensor] | None = None
    ) -> None:
        check("kl", kind, KL_KIND)
        self.kind = kind
        self.cache = cache
        self._terms: dict[Hashable, Tensor] = {}

    def __contains__(self, posterior: object) -> bool:
        return posterior in self._terms

    def add(self, posterior: Hashable, kl: Tensor) -> None:
        """Adds the KL [*replicas] of a posterior."""
        self._terms[posterior] = kl

    def total(self) -> Tensor:
        """Returns the sum over the posteriors, [*replicas], in nats.

        Raises:
            RuntimeError: if no Bayesian layer ran.
        """
        if not self._terms:
            raise RuntimeError("no Bayesian layer ran inside the weight_scope with a KL")
        first, *others = self._terms.values()
        return sum(others, first)


@dataclass(frozen=True)
class WeightScope:
    """The settings of a :func:`weight_scope` that layers read.

    Attributes:
        mode: "draw", "local", "mean", or None to follow the exploration type.
        weights: weights by posterior, used in any mode.
        noise: the noise source of weight draws; None for new noise from torch's generator.
        kl: the sum that collects the KL of the posteriors in use, or None.
        sigma: a cache of standard deviations [*replicas, P] by posterior, for draws without a KL.
            A missing posterior is added, without a gradient. None for no cache.
    """

    mode: WeightMode | None = None
    weights: Mapping[Any, Tensor] = field(default_factory=dict)
    noise: NoiseSource | None = None
    kl: KLSum | None = None
    sigma: dict[Hashable, Tensor] | None = None


_NO_SCOPE = WeightScope()


class _Local(threading.local):
    def __init__(self) -> None:
        # an instance attribute, because torch.compile guards on where it finds it
        self.scope = _NO_SCOPE


_local = _Local()


def current_scope() -> WeightScope:
    """Returns this thread's innermost :func:`weight_scope`, or an empty one outside of any."""
    return _local.scope


@contextmanager
def weight_scope(
    mode: WeightMode | None = None,
    *,
    weights: Mapping[Any, Tensor] | None = None,
    noise: NoiseSource | None = None,
    kl: KLKind | KLSum | None = None,
    sigma: dict[Hashable, Tensor] | None = None,
) -> Iterator[WeightScope]:
    """Sets the weights of the layers called inside it; omitted settings come from the outer scope.

    - ``"draw"``: one weight draw per call of a layer, shared by the rows of the call (dropout: a
      mask). A layer that a network runs twice draws twice, in a loss too; to draw once, pass it
      the weights of one :meth:`BayesLayer.draw_weights`.
    - ``"local"``: a separate draw for each row, by local reparameterization where that is exact
      (Kingma, Salimans, Welling 2015).
    - ``"mean"``: the posterior mean (dropout: off).

    Args:
        mode: one of these, or None.

    Keyword Args:
        weights: flat weights by posterior, or by module with a ``posterior``, of the shape
            [*replicas, *rows, P] that :meth:`BayesLayer.draw_weights` returns. They are used in any
            mode, including a mode passed to the call. Other posteriors are not affected.
        noise: a :class:`NoisePool` or :class:`SharedNoise` that draws take their noise from.
        kl: "closed" or "sampled" to sum the KL of every layer that runs, each counted once, or a
            :class:`KLSum`. The total is ``scope.kl.total()``.
        sigma: a cache of standard deviations, see :class:`WeightScope`.

    Raises:
        ValueError: for an unknown mode or kind of KL, or weights for something without a posterior;
            and when a layer in mode "mean" or "local" runs with kl="sampled", which needs weights
            to evaluate it at.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, weight_scope
        >>> net, x = BayesMLP(3, 2), torch.ones(4, 3)
        >>> with weight_scope("draw", kl="closed") as scope:
        ...     q = net(x)
        >>> bool((q[0] == q[1]).all()), scope.kl.total()
        (True, tensor(..., grad_fn=...))
        >>> own = net.draw_weights((4,))  # separate weights for each of four rows
        >>> with weight_scope(weights={net: own}):
        ...     bool((net(x)[0] == net(x)[1]).any())
        False
    """
    if mode is not None:
        check("mode", mode, WEIGHT_MODE)
    outer, given = _local.scope, None
    if weights is not None:
        given = {getattr(module, "posterior", module): own for module, own in weights.items()}
        for posterior in given:
            if not hasattr(posterior, "prior_rho"):
                raise ValueError(
                    "weights must be of modules with a posterior, or of posteriors, got a key of "
                    f"type {type(posterior).__name__}"
                )
    if isinstance(kl, str):
        kl = KLSum(kl)
    _local.scope = WeightScope(
        outer.mode if mode is None else mode,
        outer.weights if given is None else given,
        outer.noise if noise is None else noise,
        outer.kl if kl is None else kl,
        outer.sigma if sigma is None else sigma,
    )
    try:
        yield _local.scope
    finally:
        _local.scope = outer


def resolve_weight_mode(mode: WeightMode | None = None) -> WeightMode:
    """Returns the mode of a call: the given one, the scope's, or the exploration type's.

    TorchRL's exploration type decides if neither the call nor a :func:`weight_scope` has a mode:
    RANDOM means "draw"; DETERMINISTIC, MEAN, MODE and None (outside of any context, as for
    TorchRL's NoisyLinear) mean "mean".

    Args:
        mode: an explicit mode, or None.

    Raises:
        ValueError: for an unknown mode.
    """
    if mode is not None:
        check("mode", mode, WEIGHT_MODE)
        return mode
    return _local.scope.mode or ("draw" if interaction_type() is InteractionType.RANDOM else "mean")
