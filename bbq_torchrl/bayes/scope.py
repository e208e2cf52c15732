"""The scope that sets the weights of the layers inside of it, their noise and their KL.

A layer uses the weights that it is called with, else those that the :func:`weight_scope` around the
call gives it; else the mode that it is called with, that of the scope, or the one that follows from
the exploration type of TorchRL. So a policy or a loss reaches the layers
of a network whatever stands around them (``nn.Sequential``, a TensorDict module, a functional call)
without access to them.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

from tensordict.nn.probabilistic import InteractionType, interaction_type

from bbq_torchrl.bayes.weight_draw import KL_KIND, KLKind
from bbq_torchrl.checks import check, one_of

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping

    from torch import Tensor

    from bbq_torchrl.bayes.noise import NoiseSource

WeightMode = Literal["draw", "local", "mean"]
WEIGHT_MODE = one_of(*get_args(WeightMode))


class KLSum:
    """The KL from the prior of every posterior that is used, each counted once.

    A posterior that draws its weights adds its KL along with the draw and shares σ with it.

    Args:
        kind: "closed", or "sampled" (log q(w) - log p(w) at the draw; needs layers that draw
            their weights).
        cache: values of the closed KL by posterior, kept by the caller from one sum to the next. A
            posterior that is drawn from and found there reports the cached value with the
            gradient of today's; one that is not is added. Defaults to None: all are computed.

    Raises:
        ValueError: for another kind; at a draw, for a cache of another kind than "closed".
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
        """Adds the KL [*replicas] of a posterior that is not in the sum yet."""
        self._terms[posterior] = kl

    def total(self) -> Tensor:
        """Returns the sum over the posteriors, [*replicas], in nats.

        Raises:
            RuntimeError: if no Bayesian layer ran.
        """
        if not self._terms:
            raise RuntimeError("no Bayesian layer ran inside of the weight_scope with a KL")
        first, *others = self._terms.values()
        return sum(others, first)


@dataclass(frozen=True)
class WeightScope:
    """The settings of a :func:`weight_scope`, as layers read them.

    Attributes:
        mode: "draw", "local", "mean", or None to follow the exploration type.
        weights: weights to use whatever the mode, by posterior.
        noise: where the noise of weight draws comes from; None for new noise from torch's
            generator.
        kl: takes in the KL of the posteriors used, or None.
        sigma: a cache of standard deviations [*replicas, P] for draws without a KL, by posterior; a
            posterior that is not found is added, without a gradient. None: computed at each draw.
    """

    mode: WeightMode | None = None
    weights: Mapping[Any, Tensor] = field(default_factory=dict)
    noise: NoiseSource | None = None
    kl: KLSum | None = None
    sigma: dict[Hashable, Tensor] | None = None


_NOWHERE = WeightScope()


class _Here(threading.local):
    def __init__(self) -> None:
        # of the object, not the class: torch.compile guards on where it finds it
        self.scope = _NOWHERE


_here = _Here()


def current_scope() -> WeightScope:
    """Returns the innermost :func:`weight_scope` of this thread; an empty one outside."""
    return _here.scope


@contextmanager
def weight_scope(
    mode: WeightMode | None = None,
    *,
    weights: Mapping[Any, Tensor] | None = None,
    noise: NoiseSource | None = None,
    kl: KLKind | KLSum | None = None,
    sigma: dict[Hashable, Tensor] | None = None,
) -> Iterator[WeightScope]:
    """Sets the weights of the layers inside of it. What is not given is as outside of it.

    - ``"draw"``: one draw of a layer's weights for each of its calls, shared by the call's rows
      (dropout: a mask). A layer that a network runs twice has two draws, in a loss too; to have
      one, call it with the weights of one :meth:`BayesLayer.draw_weights`.
    - ``"local"``: a separate draw for each row, by local reparameterization where that is exact
      (Kingma, Salimans, Welling 2015).
    - ``"mean"``: the posterior mean (dropout: off).

    Args:
        mode: one of these, or None.

    Keyword Args:
        weights: for each module with a ``posterior``, or posterior, the flat weights to use
            whatever the mode, the one that it is called with too; shape [*replicas, *rows, P] as
            :meth:`BayesLayer.draw_weights` returns them. Others are not affected.
        noise: a :class:`NoisePool` or :class:`SharedNoise` that draws take their noise from.
        kl: "closed" or "sampled" to sum up the KL of every layer that runs, each counted once, or a
            :class:`KLSum`. The total is ``scope.kl.total()``.
        sigma: a cache of standard deviations, see :class:`WeightScope`.

    Raises:
        ValueError: for another mode or kind of KL, or weights of what has no posterior; and when a
            layer in mode "mean" or "local" runs with kl="sampled": there are no weights to
            evaluate it at.

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
    outer, given = _here.scope, None
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
    _here.scope = WeightScope(
        outer.mode if mode is None else mode,
        outer.weights if given is None else given,
        outer.noise if noise is None else noise,
        outer.kl if kl is None else kl,
        outer.sigma if sigma is None else sigma,
    )
    try:
        yield _here.scope
    finally:
        _here.scope = outer


def resolve_weight_mode(mode: WeightMode | None = None) -> WeightMode:
    """Returns the mode of a call with this argument.

    Without an argument and where no :func:`weight_scope` has a mode it follows TorchRL's
    exploration type: RANDOM is "draw"; DETERMINISTIC, MEAN, MODE and None (outside of any context,
    as TorchRL's NoisyLinear has it) are "mean".

    Args:
        mode: an explicit choice, or None.

    Raises:
        ValueError: for any other string.
    """
    if mode is not None:
        check("mode", mode, WEIGHT_MODE)
        return mode
    return _here.scope.mode or ("draw" if interaction_type() is InteractionType.RANDOM else "mean")
