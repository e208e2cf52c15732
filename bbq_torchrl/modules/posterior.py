"""The factorised Gaussian over a network's weights, its draws and its KL divergence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bbq_torchrl.modules.noise import fill_normal_

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

__all__ = ["GaussianPosterior", "KLKind", "inverse_softplus"]

KLKind = Literal["closed", "sampled"]
KL_KINDS: tuple[str, ...] = get_args(KLKind)

# σ/p is not taken to be smaller than this: log and 1/r stay finite where σ underflows, and so
# does the product of two of them.
_LEAST_RATIO = 1e-18

# σ/p - p/σ counts as zero up to this many machine epsilons: softplus of the very same ρ may
# differ in the last bits between the vectorised part of a loop and its remainder.
_SAME_STD = 32.0

# How many weights the passes below work on at a time: half a megabyte a vector, so that the
# handful of vectors of one piece stay in a core's cache however large the stack is.
_PIECE = 2**17

_softplus = torch.ops.aten.softplus.out
_softplus_backward = torch.ops.aten.softplus_backward.grad_input
_hardshrink = torch.ops.aten.hardshrink.out


def check_kl_kind(kind: str) -> None:
    """Raises ValueError unless ``kind`` is "closed" or "sampled"."""
    if kind not in KL_KINDS:
        raise ValueError(f"kl must be one of {list(KL_KINDS)}, got {kind!r}")


def inverse_softplus(std: Tensor) -> Tensor:
    """Returns ρ with softplus(ρ) = std, as log(expm1(std)) without overflow."""
    return std + torch.log(-torch.expm1(-std))


def _pieces(*tensors: Tensor) -> Iterator[Sequence[Tensor]]:
    """Yields tensors [*stack, *] a cache-sized part of the stack at a time (on a CPU).

    The first tensor has all weights, [*stack, P]; where it is small (or not on a CPU) the
    tensors come as they are, else with the stack as one dimension.
    """
    numel = tensors[0].shape[-1]
    count = tensors[0].numel() // numel
    size = max(1, _PIECE // numel)
    if count <= size or tensors[0].device.type != "cpu":
        yield tensors
        return
    flat = [t.reshape(count, -1) for t in tensors]
    for start in range(0, count, size):
        yield [t[start : start + size] for t in flat]


class _Draw(torch.autograd.Function):
    """(μ, ρ, p) to the draw w = μ + softplus(ρ) noise [*stack, P] and its KL [*stack]."""

    @staticmethod
    def forward(
        ctx: Any,
        mu: Tensor,
        rho: Tensor,
        prior_std: Tensor,
        kind: KLKind,
        fill_noise_: Callable[[Tensor], object],
    ) -> tuple[Tensor, Tensor]:
        weights, noise, ratio = (mu.new_empty(mu.shape) for _ in range(3))
        inverse = prior_std.reciprocal()
        kls = []
        scratch = None
        for m, r, w, n, s in _pieces(mu, rho, weights, noise, ratio):
            fill_noise_(n)
            _softplus(r, 1, 20, out=s)
            torch.addcmul(m, s, n, out=w)
            s.mul_(inverse).clamp_min_(_LEAST_RATIO)
            if scratch is None:
                scratch = torch.empty_like(s)
            elif scratch.shape != s.shape:
                scratch = scratch[: s.shape[0]]
            if kind == "closed":
                kls.append(_closed_kl(m, s, inverse, scratch))
            else:
                kls.append(_sampled_kl(w, n, s, inverse, scratch))
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(rho, noise, ratio, prior_std, mu if kind == "closed" else weights)
        ctx.kind = kind
        return weights, kls[0] if len(kls) == 1 else torch.cat(kls).reshape(mu.shape[:-1])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(
        ctx: Any, grad_weights: Tensor | None, grad_kl: Tensor | None
    ) -> tuple[Tensor | None, Tensor | None, None, None, None]:
        rho, noise, ratio, prior_std, location = ctx.saved_tensors
        if grad_kl is None:
            if grad_weights is None:
                return None, None, None, None, None
            grad_kl = rho.new_zeros(rho.shape[:-1])
        if grad_weights is None:
            grad_weights = torch.zeros_like(rho)
        grad_mu, grad_rho = rho.new_empty(rho.shape), rho.new_empty(rho.shape)
        scale = grad_kl.unsqueeze(-1) / prior_std  # [*stack, 1] or [*stack, P]
        dead_zone = _SAME_STD * torch.finfo(rho.dtype).eps
        for r, n, s, x, gw, gm, gr, factor, pull in _pieces(
            rho, noise, ratio, location, grad_weights, grad_mu, grad_rho, scale, scale / prior_std
        ):
            # d KL/dμ = μ/p²; the sampled log p(w) pulls at w, and so at σ through the noise
            torch.addcmul(gw, pull, x, out=gm)
            torch.reciprocal(s, out=gr)
            if ctx.kind == "closed":
                torch.sub(s, gr, out=gr)
                _hardshrink(gr, dead_zone, out=gr)
                gr.mul_(factor).addcmul_(gw, n)
            else:
                gr.mul_(factor).neg_().addcmul_(gm, n)
            _softplus_backward(gr, r, 1, 20, grad_input=gr)
        return grad_mu, grad_rho, None, None, None


class _ClosedKL(torch.autograd.Function):
    """(μ, ρ, p) to KL(N(μ, softplus(ρ)²) ‖ N(0, p²)), summed over the weights: [*stack]."""

    @staticmethod
    def forward(ctx: Any, mu: Tensor, rho: Tensor, prior_std: Tensor) -> Tensor:
        inverse = prior_std.reciprocal()
        ratio = F.softplus(rho).mul_(inverse).clamp_min_(_LEAST_RATIO)
        ctx.save_for_backward(mu, rho, ratio, prior_std)
        return _closed_kl(mu, ratio, inverse, torch.empty_like(ratio))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_kl: Tensor) -> tuple[Tensor, Tensor, None]:
        mu, rho, ratio, prior_std = ctx.saved_tensors
        scale = grad_kl.unsqueeze(-1) / prior_std
        grad_rho = torch.sub(ratio, ratio.reciprocal())
        grad_rho = torch.hardshrink(grad_rho, _SAME_STD * torch.finfo(rho.dtype).eps).mul_(scale)
        return (scale / prior_std) * mu, grad_rho.mul_(torch.sigmoid(rho)), None


def _closed_kl(mu: Tensor, ratio: Tensor, inverse: Tensor, scratch: Tensor) -> Tensor:
    """Returns ½ Σ (r² - 1) + ½ Σ (μ/p)² - Σ log r with r = σ/p, [*lead]."""
    log = _sum_log(ratio, scratch)
    # r² - 1 term by term: Σ r² less P would be the rounding of two large numbers near the prior
    excess = torch.addcmul(ratio.new_tensor(-1.0), ratio, ratio, out=scratch).sum(-1)
    return 0.5 * (excess + _sum_square(mu, inverse, scratch)) - log


def _sampled_kl(
    weights: Tensor, noise: Tensor, ratio: Tensor, inverse: Tensor, scratch: Tensor
) -> Tensor:
    """Returns log q(w) - log p(w) = ½ Σ (w/p)² - ½ Σ noise² - Σ log r, [*lead]."""
    log = _sum_log(ratio, scratch)
    own = _sum_square(noise, None, scratch)
    return 0.5 * (_sum_square(weights, inverse, scratch) - own) - log


def _sum_log(ratio: Tensor, scratch: Tensor) -> Tensor:
    """Returns Σ log r over the last dimension, one logarithm for two of them."""
    half = ratio.shape[-1] // 2
    odd = ratio.shape[-1] - 2 * half
    first, second, *rest = ratio.split([half, half, odd] if odd else [half, half], -1)
    out = torch.mul(first, second, out=scratch[..., :half]).log_().sum(-1)
    return out + rest[0].log().squeeze(-1) if rest else out


def _sum_square(x: Tensor, factor: Tensor | None, scratch: Tensor) -> Tensor:
    """Returns Σ (factor x)² over the last dimension."""
    if factor is not None and factor.numel() > 1:
        x, factor = torch.mul(x, factor, out=scratch), None
    norm = torch.linalg.vector_norm(x, dim=-1)
    return (norm if factor is None else norm * factor.reshape(())).square()


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
            self.rho.copy_(self.per_weight(self.prior_rho))

    def reset_std_(self, std: float) -> None:
        """Sets every standard deviation to ``std``."""
        if not 0 < std < float("inf"):
            raise ValueError(f"std_init must be positive and finite, got {std}")
        with torch.no_grad():
            self.rho.fill_(inverse_softplus(torch.tensor(std, dtype=torch.float64)).item())

    def per_weight(self, per_group: Tensor) -> Tensor:
        """Returns values per group, [1] or [groups], as values per weight, [1] or [P]."""
        if per_group.shape[0] == 1:
            return per_group
        parts = zip(per_group.unbind(), self.group_sizes, strict=True)
        return torch.cat([value.expand(size) for value, size in parts])

    @property
    def prior_std(self) -> Tensor:
        """Standard deviation of the prior, [1] if one for all, else [P]."""
        return self.per_weight(F.softplus(self.prior_rho))

    @property
    def sigma(self) -> Tensor:
        """Standard deviations [*stack, P], differentiable in rho."""
        return F.softplus(self.rho)

    def fill_noise_(self, noise: Tensor) -> None:
        """Fills ``noise`` [*, P] with standard normal numbers from torch's global generator."""
        fill_normal_(noise)

    def sample(self, rows: Sequence[int] = ()) -> Tensor:
        """Returns a draw of the weights for each of ``rows``, [*stack, *rows, P].

        Differentiable in mu and rho.
        """
        count = self.mu.shape[-1]
        noise = self.mu.new_empty((*self.stack, *rows, count))
        self.fill_noise_(noise)
        shape = (*self.stack, *(1 for _ in rows), count)
        return torch.addcmul(self.mu.reshape(shape), self.sigma.reshape(shape), noise)

    @torch.no_grad()
    def redraw_(self, draws: Tensor, where: Tensor) -> None:
        """Replaces some of the draws that :meth:`sample` returned, in place.

        Args:
            draws: shape [*stack, *rows, P].
            where: bool [*stack, *rows], True for the ones to replace.
        """
        count = self.mu.shape[-1]
        flat, mu, rho = (t.view(-1, count) for t in (draws, self.mu, self.rho))
        # New noise for all rows would cost a batch of networks for the few rows that begin
        # something, so this is the one place whose amount of work follows the data.
        which = where.flatten().nonzero().squeeze(-1)
        element = which // max(1, flat.shape[0] // mu.shape[0])
        noise = flat.new_empty((which.shape[0], count))
        self.fill_noise_(noise)
        flat[which] = torch.addcmul(mu[element], F.softplus(rho[element]), noise)

    def sample_with_kl(self, kind: KLKind = "closed") -> tuple[Tensor, Tensor]:
        """Returns a draw [*stack, P] and the KL from the prior [*stack], sharing σ.

        Args:
            kind: "closed", Σ log(p/σ) + (σ² + μ²)/(2p²) - ½, or "sampled", log q(w) - log p(w)
                at the draw, as the paper has it.

        Raises:
            ValueError: for any other string.
        """
        check_kl_kind(kind)
        weights, kl = _Draw.apply(self.mu, self.rho, self.prior_std, kind, self.fill_noise_)
        return weights, kl

    def kl(self) -> Tensor:
        """Returns the KL from the prior in closed form, [*stack], in nats."""
        out: Tensor = _ClosedKL.apply(self.mu, self.rho, self.prior_std)
        return out

    def extra_repr(self) -> str:
        """Returns the sizes for ``repr``."""
        return f"weights={sum(self.group_sizes)}, stack={tuple(self.stack)}"
