"""The factorized Gaussian posterior over a network's weights, its draws and its KL."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bbq_torchrl.bayes.functional import checked_number, replica_shape
from bbq_torchrl.bayes.noise import NoiseSource, fill_normal_, is_transformed
from bbq_torchrl.bayes.scope import KLSum, WeightMode, current_scope, resolve_weight_mode
from bbq_torchrl.bayes.weight_draw import KL_KIND, KLKind, closed_kl, draw_with_kl
from bbq_torchrl.settings import check


def inverse_softplus(std: Tensor) -> Tensor:
    """Returns ρ with softplus(ρ) = std, as log(expm1(std)) without overflow."""
    return std + torch.log(-torch.expm1(-std))


class GaussianPosterior(nn.Module):
    r"""q(w) = N(μ, softplus(ρ)²) for P independent weights, prior N(0, p²) (BBQ-Networks, 2018).

    All weights are one vector, so a draw, its KL and their gradients are a few passes over it.
    Both gradients are hand-written (the closed KL, after Blundell et al. 2015) and share one
    computation of σ. Where σ = p and μ = 0, the gradient of the closed KL is exactly 0, so weights
    that no data reach stay bitwise at the prior under any optimizer.

    Args:
        group_sizes: the number of weights in each group (in an MLP: layer); P is their sum.
        prior_std: standard deviation of the prior: one number, a sequence [groups], or a tensor
            [*replicas].

    Keyword Args:
        replicas: leading shape of independent posteriors. Defaults to ().
        device: device of the parameters.
        dtype: floating-point dtype of the parameters.

    Attributes:
        mu: parameter [*replicas, P], initially 0.
        rho: parameter [*replicas, P], initially softplus(rho) = prior_std.
        prior_rho: buffer [1], [groups] or [*replicas, 1], softplus(prior_rho) = prior_std. Stored
            instead of prior_std so that σ equals the prior's in any dtype.

    Raises:
        ValueError: if a prior_std is not positive and finite, or their number is not that of the
            groups or replicas.

    Examples:
        >>> import torch
        >>> posterior = GaussianPosterior([6, 4], 0.1, replicas=5)
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
        prior_std: float | Sequence[float] | Tensor,
        *,
        replicas: int | Sequence[int] = (),
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.group_sizes = tuple(group_sizes)
        self.replicas = replica_shape(replicas)
        std = self._prior(prior_std)
        dtype = dtype or torch.get_default_dtype()
        self.register_buffer("prior_rho", inverse_softplus(std).to(device=device, dtype=dtype))
        shape = (*self.replicas, sum(self.group_sizes))
        self.mu = nn.Parameter(torch.empty(shape, device=device, dtype=dtype))
        self.rho = nn.Parameter(torch.empty(shape, device=device, dtype=dtype))
        self.reset_parameters()

    def _prior(self, prior_std: float | Sequence[float] | Tensor) -> Tensor:
        """Returns the checked prior std, float64 [1], [groups] or [*replicas, 1]."""
        groups = prior_std if isinstance(prior_std, Sequence) else [prior_std]
        if len(groups) not in (1, len(self.group_sizes)):
            raise ValueError(
                f"prior_std must be one number or one for each of the {len(self.group_sizes)} "
                f"groups, got {len(groups)}"
            )
        replicas = self.replicas if len(groups) == 1 else ()
        return torch.stack([self._std("prior_std", std, replicas) for std in groups], -1)

    @staticmethod
    def _std(name: str, std: float | Tensor, replicas: Sequence[int]) -> Tensor:
        """Returns a checked standard deviation, float64 [] or [*replicas]."""
        return torch.as_tensor(checked_number(name, std, replicas), dtype=torch.float64)

    def reset_parameters(self) -> None:
        """Sets the posterior to the prior."""
        with torch.no_grad():
            self.mu.zero_()
            self.rho.copy_(self.per_weight(self.prior_rho))

    def reset_std_(self, std: float | Tensor) -> None:
        """Sets every standard deviation to ``std``, one number or a tensor [*replicas]."""
        with torch.no_grad():
            self.rho.copy_(
                inverse_softplus(self._std("std_init", std, self.replicas)).unsqueeze(-1)
            )

    def per_weight(self, per_group: Tensor) -> Tensor:
        """Expands values per group to values per weight: [groups] to [P]; [*, 1] is unchanged."""
        if per_group.shape[-1] == 1:
            return per_group
        parts = zip(per_group.unbind(), self.group_sizes, strict=True)
        return torch.cat([value.expand(size) for value, size in parts])

    @property
    def prior_std(self) -> Tensor:
        """Standard deviation of the prior: [1] (shared by all weights), [*replicas, 1], or [P]."""
        return self.per_weight(F.softplus(self.prior_rho))

    @property
    def sigma(self) -> Tensor:
        """Standard deviations [*replicas, P], differentiable in rho."""
        return F.softplus(self.rho)

    def fill_noise_(self, noise: Tensor) -> None:
        """Fills ``noise`` [*, P] with standard normal numbers from torch's global generator."""
        fill_normal_(noise)

    def new_noise(self, shape: Sequence[int]) -> Tensor:
        """Returns standard normal numbers of the parameters' dtype from torch's generator."""
        if is_transformed():
            return torch.randn(shape, dtype=self.mu.dtype, device=self.mu.device)
        noise = self.mu.new_empty(shape)
        self.fill_noise_(noise)
        return noise

    def weights(self, mode: WeightMode | None = None) -> Tensor:
        """Returns the weights for a layer to use, [*replicas, *rows, P].

        These are the weights that the surrounding :func:`weight_scope` sets for this posterior,
        otherwise a draw or the mean. The KL is added to the scope's sum if it has one.

        Args:
            mode: "draw", "mean", or None, which :func:`resolve_weight_mode` resolves.

        Raises:
            ValueError: for any other mode, including "local".
        """
        scope = current_scope()
        given = scope.weights.get(self)
        if given is not None:
            return given
        mode = resolve_weight_mode(mode)
        if mode == "local":
            raise ValueError(
                'mode "local" needs a layer with local reparameterization: use mode "draw" or '
                "set the weights"
            )
        if mode == "mean":
            if scope.kl is not None:
                self.add_kl(scope.kl)
            return self.mu
        if scope.kl is None or self in scope.kl:
            return self.sample(noise=scope.noise, sigma=scope.sigma)
        cache = scope.kl.cache
        known = None if cache is None else cache.get(self)
        weights, kl = self.sample_with_kl(scope.kl.kind, known, noise=scope.noise)
        scope.kl.add(self, kl)
        if cache is not None and known is None:
            cache[self] = kl.detach()
        return weights

    def sample(
        self,
        rows: Sequence[int] = (),
        *,
        noise: NoiseSource | None = None,
        sigma: dict[Hashable, Tensor] | None = None,
    ) -> Tensor:
        """Returns a draw of the weights for each of ``rows``, [*replicas, *rows, P].

        Differentiable in mu and, without a cache of σ, in rho.

        Args:
            rows: the shape of the draws; () for one draw per replica.

        Keyword Args:
            noise: the source of the noise. Defaults to None: torch's generator.
            sigma: a cache of standard deviations by posterior. Defaults to None, no cache.
        """
        full = torch.Size((*self.replicas, *rows, self.mu.shape[-1]))
        drawn = self.new_noise(full) if noise is None else noise.normal(self, full)
        shape = (*self.replicas, *(1 for _ in rows), full[-1])
        if sigma is not None and self not in sigma:
            sigma[self] = self.sigma.detach()
        std = self.sigma if sigma is None else sigma[self]
        return torch.addcmul(self.mu.reshape(shape), std.reshape(shape), drawn)

    @torch.no_grad()
    def redraw_(self, draws: Tensor, where: Tensor) -> None:
        """Replaces some of the draws that :meth:`sample` returned, in place.

        Args:
            draws: shape [*replicas, *rows, P].
            where: bool [*replicas, *rows], True for the draws to replace.
        """
        count = self.mu.shape[-1]
        flat, mu, rho = (t.view(-1, count) for t in (draws, self.mu, self.rho))
        # New noise for all rows would cost a batch of networks for the few rows that need it, so
        # here the amount of work depends on the data.
        which = where.flatten().nonzero().squeeze(-1)
        replica = which // max(1, flat.shape[0] // mu.shape[0])
        noise = flat.new_empty((which.shape[0], count))
        self.fill_noise_(noise)
        flat[which] = torch.addcmul(mu[replica], F.softplus(rho[replica]), noise)

    def sample_with_kl(
        self,
        kind: KLKind = "closed",
        known_kl: Tensor | None = None,
        *,
        noise: NoiseSource | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Returns a draw [*replicas, P] and the KL from the prior [*replicas], sharing σ.

        Args:
            kind: "closed", Σ log(p/σ) + (σ² + μ²)/(2p²) - ½, or "sampled", log q(w) - log p(w)
                at the draw, as in the paper.
            known_kl: an earlier value of the closed KL, [*replicas], to return instead of the
                current one; the gradient is the current one's. Defaults to None.

        Keyword Args:
            noise: the source of the noise. Defaults to None: torch's generator.

        Raises:
            ValueError: for an unknown kind.
        """
        check("kl", kind, KL_KIND)
        fill_noise_ = None
        if noise is not None:
            drawn = noise.normal(self, self.mu.shape)
        elif is_transformed():
            drawn = self.new_noise(self.mu.shape)
        else:  # filled in parts, along with the draw
            drawn, fill_noise_ = self.mu.new_empty(self.mu.shape), self.fill_noise_
        return draw_with_kl(self.mu, self.rho, self.prior_std, kind, drawn, fill_noise_, known_kl)

    def kl(self) -> Tensor:
        """Returns the KL from the prior in closed form, [*replicas], in nats."""
        return closed_kl(self.mu, self.rho, self.prior_std)

    def add_kl(self, total: KLSum) -> None:
        """Adds the closed KL to a sum, unless the sum includes this posterior already.

        Raises:
            ValueError: if the sum is of sampled KLs.
        """
        if self in total:
            return
        if total.kind == "sampled":
            raise ValueError(
                'kl="sampled" needs weight draws by GaussianPosterior.weights() in mode '
                f'"draw", but {self} was not drawn from: use kl="closed"'
            )
        total.add(self, self.kl())

    def extra_repr(self) -> str:
        """Returns the sizes for ``repr``."""
        return f"weights={sum(self.group_sizes)}, replicas={tuple(self.replicas)}"


def posteriors(module: nn.Module) -> list[GaussianPosterior]:
    """Returns all posteriors in ``module``, in the order of its modules.

    Raises:
        ValueError: if the module has no posterior.

    Examples:
        >>> from torch import nn
        >>> from bbq_torchrl.bayes import BayesLinear
        >>> from bbq_torchrl.bayes.posterior import posteriors
        >>> len(posteriors(nn.Sequential(BayesLinear(3, 4), nn.Tanh(), BayesLinear(4, 2))))
        2
    """
    found = [m for m in module.modules() if isinstance(m, GaussianPosterior)]
    if not found:
        raise ValueError(
            f"{type(module).__name__} has no Bayesian layer: weight draws, their KL and Thompson "
            "sampling need a network with Bayesian layers (BayesMLP, BayesLinear, or any module "
            "that contains a GaussianPosterior)"
        )
    return found


def kl_divergence(module: nn.Module) -> Tensor:
    """Returns the closed KL from the prior, summed over the module's posteriors, [*replicas].

    Raises:
        ValueError: if the module has no posterior.

    Examples:
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> prior = BayesMLP(3, 2, replicas=5, mean_init="zero", std_init=None)
        >>> bool((kl_divergence(prior) < 1e-3).all())
        True
    """
    first, *others = (posterior.kl() for posterior in posteriors(module))
    return sum(others, first)
