"""Q-values as Gaussian processes, one for each action, over features of a state."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bbq_torchrl.bayes.functional import as_rows, replica_shape
from bbq_torchrl.bayes.layers import BayesLayer
from bbq_torchrl.bayes.scope import WeightMode, current_scope, resolve_weight_mode
from bbq_torchrl.settings import ABOVE_ZERO, at_least, check, one_of

Kernel = Literal["arccos", "rbf"]
KERNEL = one_of(*get_args(Kernel))
_ALL = slice(None)
_ROWS_AT_ONCE = 512  # so that a kernel's passes over their features stay in a core's cache
_JITTER = 1e-6  # on the diagonal of kernel matrices, which is 1


class StateFeatures(nn.Module):
    """Nyström features of a kernel of states (Williams and Seeger, 2001).

    For inducing states Z and K = k(Z, Z) = L Lᵀ, φ(s) = L⁻¹ k(Z, s). So φ(s)·φ(s′) is k(s, s′)
    where one of the two is an inducing state. Elsewhere φ lacks the variance k(s, s) - |φ(s)|²,
    which is the squared norm of a second output, the rest.

    Args:
        in_features: size of a state.
        inducing: the number M of inducing states.

    Keyword Args:
        kernel: "arccos", the kernel of an infinite network with two hidden layers of ReLU (Cho and
            Saul, 2009) at (s, 1), normalized to k(s, s) = 1, or "rbf", exp(-|s - s′|² / 2l²).
        lengthscale: l in units of the median distance of inducing states, for "rbf". Defaults to 1.
        replicas: leading shape. Defaults to ().
        device: of the parameters.

    Attributes:
        size: M.
        states: parameter [*replicas, M, in] without gradient, the inducing states.
        whitening: parameter [*replicas, M, M] without gradient, L⁻ᵀ; 0 for missing states.
        scale: parameter [*replicas, 1, 1] without gradient, 1/l.

    Raises:
        ValueError: for an invalid argument.
    """

    def __init__(
        self,
        in_features: int,
        inducing: int,
        *,
        kernel: Kernel = "arccos",
        lengthscale: float = 1.0,
        replicas: int | Sequence[int] = (),
        device: torch.device | str | None = None,
    ) -> None:
        super().__init__()
        check("inducing", inducing, at_least(1))
        check("lengthscale", lengthscale, ABOVE_ZERO)
        self.kernel = check("kernel", kernel, KERNEL)
        self.lengthscale = lengthscale
        self.in_features, self.size, self.rest = in_features, inducing, in_features + 1
        self.replicas = replica_shape(replicas)

        def zeros(*shape: int) -> nn.Parameter:
            values = torch.zeros(*self.replicas, *shape, device=device)
            return nn.Parameter(values, requires_grad=False)

        self.states = zeros(inducing, in_features)
        self.whitening = zeros(inducing, inducing)
        self.scale = zeros(1, 1)

    def _of(self, replicas: slice) -> list[Tensor]:
        """Returns states, whitening and scale of some replicas, views [L, *, *]."""
        parts = (self.states, self.whitening, self.scale)
        return [part.view(-1, *part.shape[-2:])[replicas] for part in parts]

    def forward(self, x: Tensor, replicas: slice = _ALL) -> tuple[Tensor, Tensor]:
        """Returns φ [L, rows, M] and the rest [L, rows, in + 1] of states [L, rows, in]."""
        states, whitening, scale = self._of(replicas)
        phi = self._similarity(x, states, scale) @ whitening
        missing = (1 - phi.square().sum(-1, keepdim=True)).clamp_min(0).sqrt()
        return phi, missing * _unit(x)

    def _similarity(self, x: Tensor, states: Tensor, scale: Tensor) -> Tensor:
        """Returns k(x, states), [L, rows, M]."""
        if self.kernel == "rbf":
            return torch.cdist(x * scale, states * scale).square().mul(-0.5).exp()
        cosine = _unit(x) @ _unit(states).mT
        for _ in range(2):
            cosine.clamp_(-1, 1)
            sine = (1 - cosine.square()).sqrt_()
            cosine = sine.addcmul_(pi - cosine.acos(), cosine).div_(pi)
        return cosine

    @torch.no_grad()
    def choose_(self, states: Tensor, replica: int) -> None:
        """Sets a replica's inducing states to the first M different ones of ``states`` [N, in]."""
        own, whitening, scale = (part.squeeze(0) for part in self._of(slice(replica, replica + 1)))
        found = states[_first_of_each(states)[: self.size]]
        distances = torch.pdist(found)
        median = distances[distances > 0].median() if len(found) > 1 else found.new_ones(())
        scale.copy_(1 / (self.lengthscale * median.nan_to_num(1.0)))
        found64 = found.double()
        gram = self._similarity(found64, found64, scale.double())
        gram.diagonal().add_(_JITTER)
        inverse = inverse_root(gram)
        for part in (own, whitening):
            part.zero_()
        own[: len(found)] = found
        whitening[: len(found), : len(found)] = inverse.mT


def inverse_root(matrix: Tensor) -> Tensor:
    """Returns L⁻¹, with A = L Lᵀ, of a matrix A [M, M]; NaN if A is not positive definite.

    Examples:
        >>> inverse_root(torch.tensor([[4.0]])), inverse_root(torch.tensor([[-1.0]]))
        (tensor([[0.5000]]), tensor([[nan]]))
    """
    root, fault = torch.linalg.cholesky_ex(matrix)
    one = torch.eye(len(matrix), dtype=matrix.dtype, device=matrix.device)
    inverse = torch.linalg.solve_triangular(root, one, upper=False)
    return torch.where(fault == 0, inverse, torch.nan)


def _first_of_each(states: Tensor) -> Tensor:
    """Returns the first row of each different state in ``states`` [N, in], int64, in order."""
    # One number tells states apart; comparing all features takes longer than a regression.
    direction = torch.arange(1.0, states.shape[-1] + 1, device=states.device).double().sin()
    _, group = (states.double() @ direction).unique(return_inverse=True)
    rows = torch.arange(len(states), device=states.device)
    first = torch.full_like(rows, len(states)).scatter_reduce(0, group, rows, "amin")
    return first[first < len(states)].sort().values


def _unit(states: Tensor) -> Tensor:
    """Returns (s, 1) / |(s, 1)|, [*, in + 1], of states [*, in]."""
    return F.normalize(F.pad(states, (0, 1), value=1.0), dim=-1)


class GaussianProcess(BayesLayer):
    """Values φ(s)·w_a with a Gaussian posterior over each action's weights, of full covariance.

    With the posterior w_a ~ N(m_a, F_aᵀ F_a) a draw is w_a = m_a + F_aᵀ ε, and ε are the weights
    that a :func:`~bbq_torchrl.bayes.weight_scope` draws or sets: their posterior is N(0, 1), so all
    Thompson strategies work. The rest of :class:`StateFeatures` has weights p ε′ from the prior.

    The initial posterior is the prior N(0, p²). :class:`~bbq_torchrl.objectives.GPLoss` fits it.

    Args:
        features: maps states to features.
        out_features: the number A of actions.

    Keyword Args:
        prior_std: standard deviation p of each weight's prior. Defaults to 1.
        device: of the parameters.

    Attributes:
        mean: parameter [*replicas, A, M].
        factor: parameter [*replicas, A, M, M] without gradient.

    Raises:
        ValueError: for an invalid argument.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.networks import GaussianProcess
        >>> from bbq_torchrl.networks.gaussian_process import StateFeatures
        >>> network = GaussianProcess(StateFeatures(3, inducing=8), 2)
        >>> network(torch.ones(4, 3), "mean").shape, network(torch.ones(4, 3), "draw").shape
        (torch.Size([4, 2]), torch.Size([4, 2]))
    """

    def __init__(
        self,
        features: StateFeatures,
        out_features: int,
        *,
        prior_std: float = 1.0,
        device: torch.device | str | None = None,
    ) -> None:
        self.in_features, self.out_features = features.in_features, out_features
        self.size = features.size
        self.prior_std = check("prior_std", prior_std, ABOVE_ZERO)
        super().__init__(
            [out_features * (features.size + features.rest)],
            [1],
            replicas=features.replicas,
            prior_std=1.0,
            mean_init="zero",
            std_init=None,
            device=device,
        )
        self.posterior.requires_grad_(False)
        self.features = features
        shape = (*self.replicas, out_features, self.size)
        self.mean = nn.Parameter(torch.zeros(shape, device=device))
        prior = prior_std * torch.eye(self.size, device=device)
        self.factor = nn.Parameter(prior.repeat(*shape[:-1], 1, 1), requires_grad=False)

    def reset_inactive_(self, inputs: Tensor, outputs: Tensor) -> None:
        """Does nothing: a constant 0 changes no kernel, and inactive outputs are at the prior.

        See :class:`bbq_torchrl.protocols.Growing`.
        """

    def of_replica(self, replica: int) -> tuple[Tensor, Tensor]:
        """Returns mean [A, M] and factor [A, M, M] of a replica, views without gradient."""
        mean, factor = self._parts()
        return mean.detach()[replica], factor[replica]

    def features_of(self, replica: int, states: Tensor) -> tuple[Tensor, Tensor]:
        """Returns features [N, M] and rest [N, rest] of a replica for states [N, in]."""
        part = slice(replica, replica + 1)
        parts = [self.features(rows.unsqueeze(0), part) for rows in states.split(_ROWS_AT_ONCE)]
        phi, rest = zip(*parts, strict=True)
        return torch.cat(phi, 1)[0], torch.cat(rest, 1)[0]

    def deviation(self, replica: int, phi: Tensor, rest: Tensor) -> Tensor:
        """Returns what a draw of a replica's weights adds to the mean values, [N, A].

        Args:
            replica: the replica.
            phi: its features, [N, M].
            rest: their rest, [N, rest].
        """
        noise, noise_of_rest = self._split(phi.new_empty(self.posterior.mu.shape[-1]).normal_())
        _, factor = self.of_replica(replica)
        values = phi @ (factor.mT @ noise.unsqueeze(-1)).squeeze(-1).mT
        return values + self.prior_std * rest @ noise_of_rest.mT

    def _parts(self) -> tuple[Tensor, Tensor]:
        """Returns mean [L, A, M] and factor [L, A, M, M]."""
        shape = (-1, self.out_features, self.size)
        return self.mean.view(shape), self.factor.view(*shape, self.size)

    def _split(self, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Returns ε [*, A, M] and ε′ [*, A, rest] of weights [*, P]."""
        both = weights.reshape(*weights.shape[:-1], self.out_features, -1)
        return both[..., : self.size], both[..., self.size :]

    def forward(
        self, x: Tensor, mode: WeightMode | None = None, weights: Tensor | None = None
    ) -> Tensor:
        """Returns the values, shape [*replicas, *batch, A]; see :class:`BayesLayer`."""
        mode = resolve_weight_mode(mode)
        if weights is None and mode == "mean" and self.posterior not in current_scope().weights:
            phi, _ = self.features(as_rows(x, self.replicas, self.in_features))
            return self._shaped(phi @ self._parts()[0].mT, x)
        return super().forward(x, mode, weights)

    def _shaped(self, values: Tensor, x: Tensor) -> Tensor:
        return values.reshape(*x.shape[:-1], self.out_features)

    def run(self, x: Tensor, weights: Tensor) -> Tensor:
        """Returns the values of weights ε, [*replicas, *batch, A]."""
        rows = as_rows(x, self.replicas, self.in_features)
        phi, rest = self.features(rows)
        mean, factor = self._parts()
        noise, noise_of_rest = self._split(weights.reshape(len(rows), -1, weights.shape[-1]))
        draws = noise.shape[1]  # each for as many rows, one after the other
        drawn = mean.unsqueeze(1) + (noise.transpose(1, 2) @ factor).transpose(1, 2)
        values = phi.unflatten(1, (draws, -1)) @ drawn.mT
        values = values + rest.unflatten(1, (draws, -1)) @ (self.prior_std * noise_of_rest).mT
        return self._shaped(values, x)

    def run_local(self, x: Tensor) -> Tensor:
        """Returns the values with separate draws for each row, [*replicas, *batch, A]."""
        phi, rest = self.features(as_rows(x, self.replicas, self.in_features))
        mean, factor = self._parts()
        variance = (phi.unsqueeze(1) @ factor.mT).square().sum(-1).mT  # [L, rows, A]
        variance = variance + self.prior_std**2 * rest.square().sum(-1, keepdim=True)
        values = phi @ mean.mT
        return self._shaped(values + variance.sqrt() * torch.randn_like(values), x)
