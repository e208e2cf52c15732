"""The KL divergence of any network that contains Bayesian layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.bayes.context import Context
from bbq_torchrl.bayes.posterior import GaussianPosterior
from bbq_torchrl.bayes.weight_draw import KLKind, check_kl_kind

if TYPE_CHECKING:
    from torch import Tensor, nn

__all__ = ["collect_kl", "kl_divergence"]


class collect_kl(Context):
    """Collects the KL from the prior of each Bayesian layer that runs inside of the context.

    A layer that draws its weights there computes its KL along with the draw and shares σ with
    it; it is counted once, at its first call.

    Args:
        kind: "closed", or "sampled" (log q(w) - log p(w) at the draw; needs layers that draw
            their weights, see Raises).
        held: values of the closed KL by posterior, kept by the caller across contexts. A layer
            that draws its weights and is found there reports the value held, with the gradient
            of today's; one that is not computes its KL and is added. Defaults to None: nothing
            is held.

    Raises:
        ValueError: for another kind, or values held of another one than "closed"; and at the call
            of a layer in mode "mean" or "local" when the kind is "sampled": there are no weights
            to evaluate it at.

    Example:
        >>> import torch
        >>> from torch import nn
        >>> from bbq_torchrl.bayes import BayesLinear, set_weight_mode
        >>> net = nn.Sequential(BayesLinear(3, 4), nn.Tanh(), BayesLinear(4, 2))
        >>> with set_weight_mode("draw"), collect_kl() as kl:
        ...     q = net(torch.ones(5, 3))
        >>> kl.total()
        tensor(..., grad_fn=...)
    """

    def __init__(
        self, kind: KLKind = "closed", held: dict[GaussianPosterior, Tensor] | None = None
    ) -> None:
        check_kl_kind(kind)
        if held is not None and kind != "closed":
            raise ValueError(f"held values need kl='closed', got {kind!r}")
        self.kind = kind
        self._held = held
        self._terms: dict[GaussianPosterior, Tensor] = {}

    def draw(self, posterior: GaussianPosterior) -> Tensor:
        """Returns a weight draw [*stack, P] and notes the KL at the posterior's first draw."""
        if posterior in self._terms:
            return posterior.sample()
        known = None if self._held is None else self._held.get(posterior)
        weights, kl = posterior.sample_with_kl(self.kind, known)
        self._terms[posterior] = kl
        if self._held is not None and known is None:
            self._held[posterior] = kl.detach()
        return weights

    def note(self, posterior: GaussianPosterior) -> None:
        """Notes the closed KL of a posterior that is used without a weight draw."""
        if self.kind == "sampled":
            raise ValueError(
                'kl="sampled" needs weight draws: the layer runs in mode "mean" or "local", '
                'which have none. Use kl="closed" or mode "draw"'
            )
        if posterior not in self._terms:
            self._terms[posterior] = posterior.kl()

    def total(self) -> Tensor:
        """Returns the sum over the layers, [*stack], in nats.

        Raises:
            RuntimeError: if no Bayesian layer ran in the context.
        """
        if not self._terms:
            raise RuntimeError("no Bayesian layer ran inside of collect_kl()")
        first, *others = self._terms.values()
        for term in others:
            first = first + term
        return first


def kl_divergence(module: nn.Module) -> Tensor:
    """Returns the closed KL from the prior over all Bayesian layers of ``module``, [*stack].

    Raises:
        ValueError: if the module has no Bayesian layer.

    Example:
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> bool((kl_divergence(BayesMLP(3, 2, stack=(5,))) < 1e-3).all())
        True
    """
    terms = [m.kl() for m in module.modules() if isinstance(m, GaussianPosterior)]
    if not terms:
        raise ValueError(f"{type(module).__name__} has no Bayesian layer")
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total
