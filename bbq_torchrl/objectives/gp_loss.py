"""Fitted Q-iteration for Gaussian processes: a closed-form posterior from the whole buffer."""

from __future__ import annotations

from typing import Literal, get_args

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.modules import QValueActor

from bbq_torchrl.networks.gaussian_process import GaussianProcess, inverse_root
from bbq_torchrl.networks.q_actor import legal_actions, masked
from bbq_torchrl.objectives.q_learning import OneStepQLoss
from bbq_torchrl.objectives.td_loss import valid_rows
from bbq_torchrl.settings import ABOVE_ZERO, at_least, check, one_of

Target = Literal["mean", "draw"]
TARGET = one_of(*get_args(Target))
_JITTER = 1e-10  # on the diagonal of a precision, as a share of its largest entry


class GPLoss(OneStepQLoss):
    """The fit of a :class:`~bbq_torchrl.networks.GaussianProcess`.

    :meth:`fit` models the target of a transition as y = φ(s)·w_a + noise, with the prior
    w_a ~ N(w₀, prior_std²). w₀ is the posterior mean of a value that all actions share,
    y = φ(s)·w₀ + noise with w₀ ~ N(0, value_std²). Nothing is learned by gradient.

    Args:
        actor: an actor whose network is a :class:`~bbq_torchrl.networks.GaussianProcess`.

    Keyword Args:
        noise_std: standard deviation of the noise of a target, in units of Q. Defaults to 3.
        value_std: standard deviation of the prior of the shared value's weights. Defaults to 6.
        sweeps: the number of regressions of a fit, each on the targets that the one before gives.
            Defaults to 8.
        target: "mean", or "draw": the values of the next states are those of one draw of the
            posterior, the same in all sweeps (as in RLSVI, Osband et al. 2016). Defaults to "mean".
        gamma: discount, a number or a tensor [*replicas]. Defaults to 0.9.
        action_space: as in :class:`OneStepQLoss`.

    Raises:
        ValueError: for an invalid argument or another network.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.networks import GaussianProcess, q_actor
        >>> from bbq_torchrl.networks.gaussian_process import StateFeatures
        >>> from bbq_torchrl.objectives import GPLoss
        >>> network = GaussianProcess(StateFeatures(1, inducing=8), 2)
        >>> loss = GPLoss(q_actor(network, Categorical(2), action_mask_key=None), noise_std=0.1)
        >>> state = torch.arange(4.0).view(4, 1)
        >>> end = dict(reward=state, terminated=torch.ones(4, 1).bool())
        >>> td = TensorDict(
        ...     observation=state, action=torch.ones(4).long(), next=dict(observation=state, **end)
        ... )
        >>> fitted = loss.fit(td.auto_batch_size_(1))
        >>> values = network(state, "mean")[:, 1].detach()
        >>> torch.allclose(values, state[:, 0], atol=0.05)
        True
    """

    only_fits = True

    def __init__(
        self,
        actor: QValueActor,
        *,
        noise_std: float = 3.0,
        value_std: float = 6.0,
        sweeps: int = 8,
        target: Target = "mean",
        gamma: float | Tensor = 0.9,
        action_space: str | TensorSpec | None = None,
    ) -> None:
        super().__init__(actor, gamma=gamma, action_space=action_space)
        self.noise_std = check("noise_std", noise_std, ABOVE_ZERO)
        self.value_std = check("value_std", value_std, ABOVE_ZERO)
        self.sweeps = check("sweeps", sweeps, at_least(1))
        self.target = check("target", target, TARGET)
        networks = [m for m in self.value_network.modules() if isinstance(m, GaussianProcess)]
        if len(networks) != 1:
            raise ValueError(
                f"actor must have one GaussianProcess, got {type(actor).__name__} with "
                f"{len(networks)}"
            )
        # The actor's network, not a second submodule.
        (self.__dict__["network"],) = networks

    @torch.no_grad()
    def fit(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Fits each replica's posterior to all of its transitions.

        Inducing states are the first of a replica's rows, so these should be shuffled.

        Args:
            tensordict: transitions [*replicas, *batch], with "valid" if some are padding.

        Returns:
            "loss_value" (mean squared TD error after the last sweep), "td_error" and "q_value",
            each [*replicas]; NaN, as then the posterior, for a replica whose fit has no solution.
        """
        reward, index = self._reward_and_index(tensordict)
        valid = valid_rows(self, tensordict, reward.shape[:-1])
        lead = self.replicas.numel()
        after, key = tensordict["next"], self._function.in_keys[0]
        legal = legal_actions(after, self._function.action_mask_key)
        columns = {
            "state": tensordict[key],
            "after": after[key],
            "index": index,
            "reward": reward,
            "terminated": after[self.tensor_keys.terminated],
            **({} if legal is None else {"legal": legal}),
        }
        # [*replicas, *batch, n] as [L, B, n]
        rows = TensorDict(
            {name: of.reshape(lead, -1, of.shape[-1]) for name, of in columns.items()}
        ).auto_batch_size_(2)
        gammas = self.value_estimator.gamma.expand(self.replicas).reshape(lead)
        out = []
        with torch.autocast(reward.device.type, enabled=False):
            for replica, gamma in enumerate(gammas):
                own = rows[replica]
                own = own if valid is None else own[valid.reshape(lead, -1)[replica]]
                out.append(self._fit(replica, own, gamma))
        means = torch.stack(out, -1).view(3, *self.replicas)
        return TensorDict(dict(zip(("loss_value", "td_error", "q_value"), means, strict=True)))

    def _fit(self, replica: int, rows: TensorDictBase, gamma: Tensor) -> Tensor:
        """Fits a replica to its transitions [N]; returns the means of :meth:`fit`, [3]."""
        network, std = self.network, self.noise_std
        mean, kept = network.of_replica(replica)
        index, action = rows["index"], rows["index"].squeeze(-1)
        # the values of the last fit, whose features are other ones
        values = network.features_of(replica, rows["after"])[0] @ mean.mT
        network.features.choose_(rows["state"], replica)
        phi = network.features_of(replica, rows["state"])[0].double()
        phi_after, rest = network.features_of(replica, rows["after"])
        factor = posterior_factors(phi, action, len(mean), network.prior_std, std)
        kept.copy_(factor)
        of_all = torch.zeros_like(action)
        shared = posterior_factors(phi, of_all, 1, self.value_std, std)
        deviation: Tensor | float = 0.0
        if self.target == "draw":
            deviation = network.deviation(replica, phi_after, rest)
        for _ in range(self.sweeps):
            best = masked(values + deviation, rows.get("legal", None)).amax(-1, keepdim=True)
            target = rows["reward"] + gamma * torch.where(rows["terminated"], 0, best)
            target = target.double()
            prior = posterior_means(shared, phi, of_all, target.squeeze(-1), std)  # [1, M]
            excess = (target - phi @ prior.mT).squeeze(-1)
            fitted = prior + posterior_means(factor, phi, action, excess, std)
            mean.copy_(fitted)
            values = phi_after @ mean.mT
        chosen = (phi @ fitted.mT).gather(-1, index)
        error = target - chosen
        return torch.stack([error.square().mean(), error.abs().mean(), chosen.mean()]).to(mean)


def posterior_factors(
    features: Tensor, action: Tensor, actions: int, prior_std: float, noise_std: float
) -> Tensor:
    """Returns F [A, M, M] with Fᵀ F = (I / p² + Σ φ φᵀ / σ²)⁻¹, each action's posterior covariance.

    The sum is over the action's rows. One Cholesky decomposition an action, in the features' dtype:
    float64 for many rows with little noise. NaN for an action without a solution.

    Args:
        features: φ, shape [N, M].
        action: the action of each row, int64 [N].
        actions: the number A of actions.
        prior_std: standard deviation p of each weight's prior.
        noise_std: standard deviation σ of the targets' noise.

    Examples:
        >>> posterior_factors(torch.ones(3, 1), torch.zeros(3).long(), 2, 1.0, 1.0)
        tensor([[[0.5000]],
                [[1.0000]]])
    """
    size = features.shape[-1]
    counts = action.bincount(minlength=actions).tolist()
    factors = features.new_empty(actions, size, size)
    for number, rows in enumerate(features[action.argsort(stable=True)].split(counts)):
        precision = rows.mT @ rows / noise_std**2
        precision.diagonal().add_(prior_std**-2 + _JITTER * precision.diagonal().max())
        factors[number] = inverse_root(precision)
    return factors


def posterior_means(
    factors: Tensor, features: Tensor, action: Tensor, target: Tensor, noise_std: float
) -> Tensor:
    """Returns the posterior means of each action's weights, [A, M], for a prior of mean 0.

    Args:
        factors: the output of :func:`posterior_factors`, [A, M, M].
        features: φ, shape [N, M].
        action: the action of each row, int64 [N].
        target: shape [N].
        noise_std: standard deviation of the targets' noise.
    """
    weights = target.new_zeros(len(factors), len(target))
    weights.scatter_(0, action.unsqueeze(0), (target / noise_std**2).unsqueeze(0))
    sums = weights @ features
    return (factors.mT @ (factors @ sums.unsqueeze(-1))).squeeze(-1)
