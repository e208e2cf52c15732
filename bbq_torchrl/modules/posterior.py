"""The factorised Gaussian over a network's weights, its draws and its KL divergence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor, nn

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["GaussianPosterior", "KLKind", "inverse_softplus"]

KLKind = Literal["closed", "sampled"]
KL_KINDS: tuple[str, ...] = get_args(KLKind)

# σ = softplus(ρ) underflows in float32 below ρ = -103, and log σ with it. Below this floor (far
# under any σ that matters) σ stays where it is, while ρ still gets the floor's gradient.
RHO_FLOOR = -80.0

# σ/p - p/σ counts as zero up to this many machine epsilons: softplus of the very same ρ may
# differ in the last bits between the vectorised part of a loop and its remainder.
_SAME_STD = 32.0


def check_kl_kind(kind: str) -> None:
    """Raises ValueError unless ``kind`` is "closed" or "sampled"."""
    if kind not in KL_KINDS:
        raise ValueError(f"kl must be one of {list(KL_KINDS)}, got {kind!r}")


def inverse_softplus(std: Tensor) -> Tensor:
    """Returns ρ with softplus(ρ) = std, as log(expm1(std)) without overflow."""
    return std + torch.log(-torch.expm1(-std))


class _Draw(torch.autograd.Function):
    """(μ, ρ, noise, p) to the draw w = μ + softplus(ρ) noise [*stack, P] and its KL [*stack]."""

    @staticmethod
    def forward(
        ctx: Any, mu: Tensor, rho: Tensor, noise: Tensor, prior_std: Tensor, kind: KLKind
    ) -> tuple[Tensor, Tensor]:
        rho = rho.clamp_min(RHO_FLOOR)
        sigma = F.softplus(rho)
        weights = torch.addcmul(mu, sigma, noise)
        ratio = sigma.mul_(prior_std.reciprocal())
        if kind == "closed":
            kl = _closed_kl(mu, ratio, prior_std)
        else:
            kl = _sampled_kl(weights, noise, ratio, prior_std)
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(rho, noise, ratio, prior_std, mu if kind == "closed" else weights)
        ctx.kind = kind
        return weights, kl

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(
        ctx: Any, grad_weights: Tensor | None, grad_kl: Tensor | None
    ) -> tuple[Tensor | None, Tensor | None, None, None, None]:
        rho, noise, ratio, prior_std, location = ctx.saved_tensors
        if grad_weights is None and grad_kl is None:
            return None, None, None, None, None
        grad_mu = grad_weights
        if grad_kl is not None:
            scale = grad_kl.unsqueeze(-1) / prior_std
            # d KL/dμ = μ/p²; of the sampled log p(w) the same at w, through which σ gets it too
            pull = scale / prior_std
            grad_mu = (
                pull * location
                if grad_weights is None
                else torch.addcmul(grad_weights, pull, location)
            )
        through = grad_weights if ctx.kind == "closed" else grad_mu
        grad_sigma = None if through is None else through * noise
        if grad_kl is not None:
            own = torch.reciprocal(ratio)
            own = (_std_pull(ratio, own) if ctx.kind == "closed" else own.neg_()).mul_(scale)
            grad_sigma = own if grad_sigma is None else grad_sigma.add_(own)
        assert grad_sigma is not None
        return grad_mu, grad_sigma.mul_(torch.sigmoid(rho)), None, None, None


class _ClosedKL(torch.autograd.Function):
    """(μ, ρ, p) to KL(N(μ, softplus(ρ)²) ‖ N(0, p²)), summed over the weights: [*stack]."""

    @staticmethod
    def forward(ctx: Any, mu: Tensor, rho: Tensor, prior_std: Tensor) -> Tensor:
        rho = rho.clamp_min(RHO_FLOOR)
        ratio = F.softplus(rho).mul_(prior_std.reciprocal())
        ctx.save_for_backward(mu, rho, ratio, prior_std)
        return _closed_kl(mu, ratio, prior_std)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_kl: Tensor) -> tuple[Tensor, Tensor, None]:
        mu, rho, ratio, prior_std = ctx.saved_tensors
        scale = grad_kl.unsqueeze(-1) / prior_std
        grad_rho = _std_pull(ratio, torch.reciprocal(ratio)).mul_(scale).mul_(torch.sigmoid(rho))
        return (scale / prior_std) * mu, grad_rho, None


def _closed_kl(mu: Tensor, ratio: Tensor, prior_std: Tensor) -> Tensor:
    # ½ Σ (r² - 1 - 2 log r) + ½ Σ (μ/p)² with r = σ/p, term by term: the sum of all r² less P
    # would leave only the rounding of two large numbers where q is near the prior.
    terms = torch.addcmul(ratio.new_tensor(-1.0), ratio, ratio)
    terms.sub_(ratio.log(), alpha=2)
    return 0.5 * (terms.sum(-1) + (mu / prior_std).square_().sum(-1))


def _sampled_kl(weights: Tensor, noise: Tensor, ratio: Tensor, prior_std: Tensor) -> Tensor:
    # log q(w) - log p(w) = -log r - ½ noise² + ½ (w/p)²
    terms = (weights / prior_std).square_().sub_(noise.square()).mul_(0.5)
    return terms.sub_(ratio.log()).sum(-1)


def _std_pull(ratio: Tensor, reciprocal: Tensor) -> Tensor:
    """Returns r - 1/r in ``reciprocal``'s memory, exactly 0 where σ is the prior's."""
    torch.sub(ratio, reciprocal, out=reciprocal)
    dead_zone = _SAME_STD * torch.finfo(ratio.dtype).eps
    return torch.hardshrink(reciprocal, dead_zone)


class GaussianPosterior(nn.Module):
    r"""q(w) = N(μ, softplus(ρ)²) for P independent weights, prior N(0, p²) (BBQ-Networks, 2018).

    All weights lie in one vector, so that a draw, its KL and their gradients are a few passes
    over it; both gradients are written by hand (closed KL, after Blundell et al. 2015) and σ is
    computed once for the two. Where σ = p and μ = 0 the closed KL has a gradient of exactly 0,
    so that weights which no data reach stay bitwise at the prior under any optimiser.

    Args:
        group_sizes: how many weights each group (for an MLP: layer) has; P is their sum.
        prior_std: standard deviation of the prior, one number for all groups or one a group.

    Keyword Args:
        stack: leading shape; an independent posterior for each element. Defaults to ().
        device: of the parameters.
        dtype: of the parameters, a floating one.

    Attributes:
        mu: parameter [*stack, P], 0 at first.
        rho: parameter [*stack, P], softplus(rho) = prior_std at first.
        prior_rho: buffer [1] or [groups], softplus(prior_rho) = prior_std. Kept in the place
            of prior_std so that σ meets the prior's in any dtype.

    Raises:
        ValueError: if a prior_std is not a positive finite number.

    Example:
        >>> import torch
        >>> posterior = GaussianPosterior([6, 4], 0.1, stack=(5,))
        >>> posterior.sample().shape, posterior.sample((32,)).shape
        (torch.Size([5, 10]), torch.Size([5, 32, 10]))
        >>> weights, kl = posterior.sample_with_kl()
        >>> kl.shape, bool((kl.abs() < 1e-5).all())
        (torch.Size([5]), True)
    """

    prior_rho: Tensor

    def __init__(
        self,
        group_sizes: Sequence[int],
        prior_std: float | Sequence[float],
        *,
        stack: Sequence[int] = (),
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.group_sizes = tuple(group_sizes)
        self.stack = torch.Size(stack)
        groups = [prior_std] if isinstance(prior_std, (int, float)) else list(prior_std)
        for value in groups:
            if not 0 < value < float("inf"):
                raise ValueError(f"prior_std must be positive and finite, got {value}")
        if len(groups) not in (1, len(self.group_sizes)):
            raise ValueError(
                f"prior_std must be one number or one for each of the {len(self.group_sizes)} "
                f"groups, got {len(groups)}"
            )
        std = torch.tensor(groups, dtype=torch.float64)
        dtype = dtype or torch.get_default_dtype()
        self.register_buffer("prior_rho", inverse_softplus(std).to(device=device, dtype=dtype))
        shape = (*self.stack, sum(self.group_sizes))
        self.mu = nn.Parameter(torch.empty(shape, device=device, dtype=dtype))
        self.rho = nn.Parameter(torch.empty(shape, device=device, dtype=dtype))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Sets the posterior to the prior."""
        with torch.no_grad():
            self.mu.zero_()
            self.rho.copy_(self._per_weight(self.prior_rho))

    def reset_std_(self, std: float) -> None:
        """Sets every standard deviation to ``std``."""
        if not 0 < std < float("inf"):
            raise ValueError(f"std_init must be positive and finite, got {std}")
        with torch.no_grad():
            self.rho.fill_(inverse_softplus(torch.tensor(std, dtype=torch.float64)).item())

    def _per_weight(self, per_group: Tensor) -> Tensor:
        """Returns [1] or [groups] as [1] or [P]."""
        if per_group.shape[0] == 1:
            return per_group
        parts = zip(per_group.unbind(), self.group_sizes, strict=True)
        return torch.cat([value.expand(size) for value, size in parts])

    @property
    def prior_std(self) -> Tensor:
        """Standard deviation of the prior, [1] if one for all, else [P]."""
        return self._per_weight(F.softplus(self.prior_rho))

    @property
    def sigma(self) -> Tensor:
        """Standard deviations [*stack, P], differentiable in rho."""
        return F.softplus(self.rho.clamp_min(RHO_FLOOR))

    def noise(self, rows: Sequence[int] = ()) -> Tensor:
        """Returns standard normal noise [*stack, *rows, P] from torch's global generator."""
        shape = (*self.stack, *rows, self.mu.shape[-1])
        return torch.randn(shape, device=self.mu.device, dtype=self.mu.dtype)

    def sample(self, rows: Sequence[int] = ()) -> Tensor:
        """Returns a draw of the weights for each of ``rows``, [*stack, *rows, P].

        Differentiable in mu and rho.
        """
        shape = (*self.stack, *(1 for _ in rows), self.mu.shape[-1])
        return torch.addcmul(self.mu.reshape(shape), self.sigma.reshape(shape), self.noise(rows))

    def sample_with_kl(self, kind: KLKind = "closed") -> tuple[Tensor, Tensor]:
        """Returns a draw [*stack, P] and the KL from the prior [*stack], sharing σ.

        Args:
            kind: "closed", Σ log(p/σ) + (σ² + μ²)/(2p²) - ½, or "sampled", log q(w) - log p(w)
                at the draw, as the paper has it.

        Raises:
            ValueError: for any other string.
        """
        check_kl_kind(kind)
        weights, kl = _Draw.apply(self.mu, self.rho, self.noise(), self.prior_std, kind)
        return weights, kl

    def kl(self) -> Tensor:
        """Returns the KL from the prior in closed form, [*stack], in nats."""
        out: Tensor = _ClosedKL.apply(self.mu, self.rho, self.prior_std)
        return out

    def extra_repr(self) -> str:
        """Returns the sizes for ``repr``."""
        return f"weights={sum(self.group_sizes)}, stack={tuple(self.stack)}"
