"""A draw of all weights of a Gaussian posterior and its KL, with hand-written gradients.

Both are a few passes over vectors with one element per weight, and memory traffic dominates their
cost. So they share one computation of σ, reuse temporaries, and process the replicas of a network
in cache-sized pieces.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from bbq_torchrl.bayes.functional import once_differentiable
from bbq_torchrl.bayes.noise import is_transformed
from bbq_torchrl.settings import one_of

KLKind = Literal["closed", "sampled"]
KL_KIND = one_of(*get_args(KLKind))

# The lower bound of σ/p: log and 1/r stay finite where σ underflows, and so does the product of
# two of them.
_LEAST_RATIO = 1e-18

# σ/p - p/σ counts as zero up to this many machine epsilons: softplus of the same ρ may differ in
# the last bits between the vectorized part of a loop and its remainder.
_SAME_STD = 32.0

# The number of weights that the passes below process at once: half a megabyte per vector, so that
# the vectors of a piece stay in a core's cache for any number of replicas.
_PIECE = 2**17

# A full read of the constants of torch's log1p, by an input of -0.0. With AVX-512, torch 2.14's
# log1p and softplus otherwise only read them masked, which the processor does ten times as slowly
# as long as nothing has loaded their page into memory.
torch.tensor(-0.0, dtype=torch.float32, device="cpu").log1p()

_softplus = torch.ops.aten.softplus.out
_softplus_backward = torch.ops.aten.softplus_backward.grad_input
_hardshrink = torch.ops.aten.hardshrink.out


def _pieces(*tensors: Tensor) -> Iterator[Sequence[Tensor]]:
    """Yields tensors [*replicas, *] in cache-sized parts of the replicas (on a CPU).

    The first tensor has all weights, [*replicas, P]. If it is small (or not on a CPU), the tensors
    are yielded unchanged, otherwise with the replicas as one dimension. A tensor without replicas,
    such as a shared prior [1] or [P], is yielded whole with every part.
    """
    numel = tensors[0].shape[-1]
    count = tensors[0].numel() // numel
    size = max(1, _PIECE // numel)
    if count <= size or tensors[0].device.type != "cpu":
        yield tensors
        return
    flat = [t.reshape(count, -1) if t.ndim > 1 else t for t in tensors]
    for start in range(0, count, size):
        yield [t[start : start + size] if t.ndim > 1 else t for t in flat]


class _Draw(torch.autograd.Function):
    """Maps (μ, ρ, p) to a draw w = μ + softplus(ρ) noise [*replicas, P] and its KL [*replicas]."""

    @staticmethod
    def forward(
        ctx: Any,
        mu: Tensor,
        rho: Tensor,
        prior_std: Tensor,
        kind: KLKind,
        noise: Tensor,
        fill_noise_: Callable[[Tensor], object] | None,
        known_kl: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        weights, ratio = mu.new_empty(mu.shape), mu.new_empty(mu.shape)
        inverse = prior_std.reciprocal()
        kls = []
        scratch = None
        for m, r, w, n, s, p in _pieces(mu, rho, weights, noise, ratio, inverse):
            if fill_noise_ is not None:
                fill_noise_(n)
            _softplus(r, 1, 20, out=s)
            torch.addcmul(m, s, n, out=w)
            s.mul_(p).clamp_min_(_LEAST_RATIO)
            if known_kl is not None:
                continue
            if scratch is None:
                scratch = torch.empty_like(s)
            elif scratch.shape != s.shape:
                scratch = scratch[: s.shape[0]]
            if kind == "closed":
                kls.append(_closed_kl_value(m, s, p, scratch))
            else:
                kls.append(_sampled_kl_value(w, n, s, p, scratch))
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(rho, noise, ratio, prior_std, mu if kind == "closed" else weights)
        ctx.kind = kind
        if known_kl is not None:
            return weights, known_kl.clone()
        return weights, kls[0] if len(kls) == 1 else torch.cat(kls).reshape(mu.shape[:-1])

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any, grad_weights: Tensor | None, grad_kl: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        rho, noise, ratio, prior_std, location = ctx.saved_tensors
        if grad_kl is None:
            if grad_weights is None:
                return (None,) * 7
            grad_kl = rho.new_zeros(rho.shape[:-1])
        if grad_weights is None:
            grad_weights = torch.zeros_like(rho)
        grad_mu, grad_rho = rho.new_empty(rho.shape), rho.new_empty(rho.shape)
        scale = grad_kl.unsqueeze(-1) / prior_std  # [*replicas, 1] or [*replicas, P]
        dead_zone = _SAME_STD * torch.finfo(rho.dtype).eps
        for r, n, s, x, gw, gm, gr, factor, pull in _pieces(
            rho, noise, ratio, location, grad_weights, grad_mu, grad_rho, scale, scale / prior_std
        ):
            # d KL/dμ = μ/p²; the sampled log p(w) acts on w, and through the noise on σ
            torch.addcmul(gw, pull, x, out=gm)
            if ctx.kind == "closed":
                # σ/p - p/σ; addcdiv needs one pass only, but takes three times as long
                torch.sub(s, torch.reciprocal(s, out=gr), out=gr)
                _hardshrink(gr, dead_zone, out=gr)
                gr.mul_(factor).addcmul_(gw, n)
            else:
                torch.reciprocal(s, out=gr)
                gr.mul_(factor).neg_().addcmul_(gm, n)
            _softplus_backward(gr, r, 1, 20, grad_input=gr)
        return grad_mu, grad_rho, None, None, None, None, None


def _closed_kl_value(mu: Tensor, ratio: Tensor, inverse: Tensor, scratch: Tensor) -> Tensor:
    """Returns ½ Σ (r² - 1) + ½ Σ (μ/p)² - Σ log r with r = σ/p, [*lead]."""
    log = _sum_log(ratio, scratch)
    # r² - 1 term by term: near the prior Σ r² - P would cancel two large numbers
    excess = torch.addcmul(ratio.new_full((), -1.0), ratio, ratio, out=scratch).sum(-1)
    return 0.5 * (excess + _sum_square(mu, inverse, scratch)) - log


def _sampled_kl_value(
    weights: Tensor, noise: Tensor, ratio: Tensor, inverse: Tensor, scratch: Tensor
) -> Tensor:
    """Returns log q(w) - log p(w) = ½ Σ (w/p)² - ½ Σ noise² - Σ log r, [*lead]."""
    log = _sum_log(ratio, scratch)
    own = _sum_square(noise, None, scratch)
    return 0.5 * (_sum_square(weights, inverse, scratch) - own) - log


def _sum_log(ratio: Tensor, scratch: Tensor) -> Tensor:
    """Returns Σ log r over the last dimension, with one logarithm per pair."""
    half = ratio.shape[-1] // 2
    odd = ratio.shape[-1] - 2 * half
    first, second, *rest = ratio.split([half, half, odd] if odd else [half, half], -1)
    out = torch.mul(first, second, out=scratch[..., :half]).log_().sum(-1)
    return out + rest[0].log().squeeze(-1) if rest else out


def _sum_square(x: Tensor, factor: Tensor | None, scratch: Tensor) -> Tensor:
    """Returns Σ (factor x)² over the last dimension; factor [1], [P], [*lead, 1] or [*lead, P]."""
    if factor is not None and factor.shape[-1] > 1:
        x, factor = torch.mul(x, factor, out=scratch), None
    norm = torch.linalg.vector_norm(x, dim=-1)
    return (norm if factor is None else norm * factor.squeeze(-1)).square()


def closed_kl(mu: Tensor, rho: Tensor, prior_std: Tensor) -> Tensor:
    """Returns KL(N(μ, softplus(ρ)²) ‖ N(0, p²)) summed over the weights, [*replicas].

    Differentiable in mu and rho; arguments as those of :func:`draw_with_kl`.
    """
    ratio = (F.softplus(rho) / prior_std).clamp_min(_LEAST_RATIO)
    # 1, without a gradient, where σ = p: see _SAME_STD
    is_same = (ratio - ratio.reciprocal()).abs() <= _SAME_STD * torch.finfo(rho.dtype).eps
    ratio = torch.where(is_same, 1.0, ratio)
    return (0.5 * (ratio.square() - 1 + (mu / prior_std).square()) - ratio.log()).sum(-1)


def _sampled_kl(weights: Tensor, noise: Tensor, rho: Tensor, prior_std: Tensor) -> Tensor:
    """Returns log q(w) - log p(w), [*replicas], by torch's operations."""
    ratio = (F.softplus(rho) / prior_std).clamp_min(_LEAST_RATIO)
    return (0.5 * ((weights / prior_std).square() - noise.square()) - ratio.log()).sum(-1)


def draw_with_kl(
    mu: Tensor,
    rho: Tensor,
    prior_std: Tensor,
    kind: KLKind,
    noise: Tensor,
    fill_noise_: Callable[[Tensor], object] | None,
    known_kl: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Returns the draw μ + softplus(ρ) noise [*replicas, P] and its KL from N(0, p²) [*replicas].

    Differentiable in mu and rho (once).

    Args:
        mu: shape [*replicas, P].
        rho: shape [*replicas, P].
        prior_std: p, shape [1] or [P] if all replicas share it, else [*replicas, 1] or
            [*replicas, P].
        kind: "closed", the divergence itself, or "sampled", log q(w) - log p(w) at the draw.
        noise: shape [*replicas, P], contiguous if it is to be filled.
        fill_noise_: fills a tensor [*, P] with standard normal numbers; called on ``noise``, in
            parts. None if ``noise`` contains them already.
        known_kl: shape [*replicas], returned instead of the value of the closed KL, which takes a
            large part of the draw to compute; the gradient is still the closed KL's. None to
            compute it.
    """
    if is_transformed():
        weights = torch.addcmul(mu, F.softplus(rho), noise)
        if kind == "closed":
            return weights, closed_kl(mu, rho, prior_std)
        return weights, _sampled_kl(weights, noise, rho, prior_std)
    weights, kl = _Draw.apply(mu, rho, prior_std, kind, noise, fill_noise_, known_kl)
    return weights, kl
