r"""The information gain of a transition, and the reward for it (VIME, Houthooft et al. 2016).

The information gain of a transition is the divergence of the posterior after learning from it
from the posterior before. One natural-gradient step of length λ on the loss -log p(s'|s, a; w),
w = μ + σ ε, moves the variational parameters by -λ H⁻¹ g, where H is the Hessian of this
divergence. It is diagonal, 1/σ² for μ and 2 (dσ/dρ)²/σ² for ρ, so to second order

    gain = ½ λ² gᵀ H⁻¹ g     (VIME, Houthooft et al. 2016, section 2.3).

With g_μ = g_w and g_ρ = g_w ε dσ/dρ, dσ/dρ cancels, and a weight adds g_w² σ² (1 + ε²/2). In a
layer g_w is the product of its input a and its output's error δ. So the sum over its matrix needs
no gradients of single transitions, only one more matrix product for all of them:

    gain = ½ λ² Σ_layers Σ_j δ_j² [ Σ_i a_i² σ_ij² (1 + ε_ij²/2) + σ_bj² (1 + ε_bj²/2) ].

The prior's term is left out: the prior of a step is the posterior before it, where the gradient of
this term is 0.

Gains are measured in units of a running median, :class:`RunningMedian`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod
from typing import Literal, get_args

import torch
import torch.nn.functional as F
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.envs import Transform

from bbq_torchrl.bayes.functional import affine, checked_number, run_layers
from bbq_torchrl.settings import ABOVE_ZERO, AT_LEAST_ZERO, at_least, check, one_of
from bbq_torchrl.utils.seeds import checked_seed
from bbq_torchrl.vime.dynamics import DynamicsModel


@torch.no_grad()
def information_gain(
    dynamics: DynamicsModel,
    observation: Tensor,
    action: Tensor,
    next_observation: Tensor,
    *,
    noise: Tensor | None = None,
    step_size: float = 0.01,
) -> Tensor:
    """Returns the information gain of each transition, [*replicas, *rows], in nats, detached.

    Args:
        dynamics: the model and its posterior.
        observation: state, shape [*replicas, *rows, S].
        action: index [*replicas, *rows] or vector [*replicas, *rows, A].
        next_observation: next state, shape [*replicas, *rows, S].

    Keyword Args:
        noise: ε, shape [*replicas, P], the noise of one weight draw for all rows; None for the gain
            at the mean, ε = 0.
        step_size: λ; the gain is proportional to its square. Defaults to 0.01.

    Raises:
        ValueError: for a wrong shape.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.vime import DynamicsModel, information_gain
        >>> dynamics = DynamicsModel(3, 2, replicas=5)
        >>> state, action = torch.randn(5, 32, 3), torch.randint(2, (5, 32))
        >>> gain = information_gain(dynamics, state, action, torch.randn(5, 32, 3))
        >>> gain.shape, bool((gain > 0).all())
        (torch.Size([5, 32]), True)
    """
    x, target = dynamics.inputs(observation, action), dynamics.standardize(next_observation)
    layout, posterior = dynamics.network.layout, dynamics.network.posterior
    if target.shape[:-1] != x.shape[:-1]:
        raise ValueError(
            f"next_observation must have shape {list(observation.shape)}, got "
            f"{list(next_observation.shape)}"
        )
    if noise is not None and noise.shape != posterior.mu.shape:
        raise ValueError(
            f"noise must have shape {list(posterior.mu.shape)}, got {list(noise.shape)}"
        )
    weights: Tensor = posterior.mu
    sigma = posterior.sigma
    variance = sigma.square()
    if noise is not None:
        weights = torch.addcmul(weights, sigma, noise)
        variance.mul_(noise.square().mul_(0.5).add_(1))
    variances = layout.unflatten(variance.view(-1, layout.numel))

    rows = x.reshape(prod(posterior.replicas), -1, layout.sizes[0])
    error, inputs, matrices = run_layers(rows, weights, layout)
    error.sub_(target.reshape(error.shape)).div_(dynamics.noise_std**2)

    gain = error.new_zeros(error.shape[:-1])
    for k in range(len(matrices) - 1, -1, -1):
        spread = affine(inputs[k].square(), *variances[k])
        gain += spread.mul_(error.square()).sum(-1)
        if k > 0:
            error = torch.bmm(error, matrices[k].mT).mul_(inputs[k] > 0)
    # where the posterior is so wide that the sum overflows, the gain is the largest float
    gain = gain.mul_(0.5 * step_size**2).clamp_max_(torch.finfo(gain.dtype).max)
    return gain.reshape(x.shape[:-1])


class RunningMedian(nn.Module):
    """The median of the medians of the last calls, for each replica.

    A median depends neither on the order of the values nor on the number of invalid ones, so
    replicas stay independent to the bit. (For an even number of values it is the lower one.)

    Args:
        replicas: leading shape.
        window: the number of calls, at least 1.
        like: a tensor with the dtype and device of the buffers.

    Attributes:
        medians: buffer [*replicas, window], the medians of the last calls, overwritten in turns.
        calls: int64 buffer [*replicas], the number of calls with a valid value.

    Examples:
        >>> import torch
        >>> median = RunningMedian((), 2, torch.zeros(1))
        >>> for values in ([1.0, 2.0, 9.0], [4.0], [5.0, 7.0]):
        ...     median.update(torch.tensor(values))
        tensor(2.)
        tensor(2.)
        tensor(4.)
    """

    medians: Tensor
    calls: Tensor

    def __init__(self, replicas: Sequence[int], window: int, like: Tensor) -> None:
        super().__init__()
        self.register_buffer("medians", like.new_zeros((*replicas, window)))
        self.register_buffer("calls", like.new_zeros(tuple(replicas), dtype=torch.int64))

    @torch.no_grad()
    def update(self, values: Tensor, valid: Tensor | None = None) -> Tensor:
        """Adds values and returns the median of the last medians, [*replicas]; NaN without values.

        Args:
            values: shape [*replicas, n]; NaN is ignored.
            valid: bool [*replicas, n], True for valid values; None for all. A replica without
                valid values keeps its state.
        """
        window = self.medians.shape[-1]
        if valid is not None:
            values = torch.where(valid, values, torch.nan)
        median = values.nanmedian(-1, keepdim=True).values
        calls = self.calls.unsqueeze(-1)
        slots = torch.arange(window, device=values.device)
        is_new = ~median.isnan()
        here = is_new & (slots == calls % window)
        self.medians.copy_(torch.where(here, median, self.medians))
        calls = calls + is_new
        self.calls.copy_(calls.squeeze(-1))
        return torch.where(slots < calls, self.medians, torch.nan).nanmedian(-1).values


GainWeights = Literal["map", "mc"]

_REWARD, _BONUS = ("next", "reward"), ("next", "intrinsic_reward")
_PIECE = 256  # rows processed at once, so that a row does not depend on the number of others


class VIMEReward(Transform):
    r"""Adds the information gain of a dynamics model to each stored transition as a bonus.

    This is a transform of a replay buffer, not of an environment:

    - Storing adds the new states to the model's running statistics, computes the gain of each new
      transition under the current posterior (:func:`~bbq_torchrl.vime.reward`), and
      stores

          bonus = min(gain / m, clip),  m = median of the last ``median_window`` stores' medians,

      under ``("next", "intrinsic_reward")``. The stored reward is the task's, so reported rewards
      exclude the bonus. The gain is that of the new transition and is not computed again.
    - Reading returns transitions with ``("next", "reward")`` = task reward + eta · bonus. The
      stored transitions are unchanged and can be read again. A read transition has both the sum
      and the bonus, so copy a buffer from its ``storage`` (``other.extend(buffer.storage[:])``).
      Storing ``buffer[:]`` would add the bonus a second time.

    m includes the median of the current store. So m is defined from the first store on, and an
    untrained model gives a bonus around 1: earlier transitions (a spiked buffer) have neither an
    advantage nor a disadvantage. As the model learns, all gains fall and m follows, so the bonus
    measures the gain relative to the usual. The step size λ cancels.

    Terminated transitions get a bonus of 0, as the model does not predict them, and are excluded
    from the medians, as are rows that an optional entry "valid", bool [*batch], marks as False.
    Transitions that already have a bonus keep it and do not change statistics or medians.

    Replicas are independent: a replica's bonuses do not depend, to the bit, on another's
    transitions or on the number of rows.

    Args:
        dynamics: the model; pass it to a :class:`~bbq_torchrl.vime.DynamicsLoss` too.

    Keyword Args:
        eta: η, the worth of a bonus of 1 in units of the task reward; a number or a tensor
            [*replicas]. Defaults to 0.1.
        weights: "map", the gain at the posterior's mean, or "mc", at one weight draw per store,
            shared by its transitions. Defaults to "map".
        step_size: λ of the gain. Defaults to 0.01.
        median_window: the number of stores in m; use more if each has only a few transitions.
            Defaults to 10.
        clip: the maximum bonus. Defaults to 10.

    Attributes:
        median: m, a :class:`~bbq_torchrl.vime.reward.RunningMedian`, with its buffers.

    Raises:
        ValueError: for an invalid argument.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> from bbq_torchrl.vime import DynamicsModel, VIMEReward
        >>> transform = VIMEReward(DynamicsModel(4, 2), eta=0.5)
        >>> memory = TensorDictReplayBuffer(
        ...     storage=LazyTensorStorage(1000), transform=transform, batch_size=32
        ... )
        >>> end = dict(reward=torch.ones(100, 1), terminated=torch.zeros(100, 1).bool())
        >>> rows = TensorDict(observation=torch.randn(100, 4), action=torch.randint(2, (100,)))
        >>> rows["next"] = {"observation": torch.randn(100, 4), **end}
        >>> _ = memory.extend(rows.auto_batch_size_(1))
        >>> batch = memory.sample()
        >>> torch.equal(
        ...     batch["next", "reward"], 1 + 0.5 * batch["next", "intrinsic_reward"]
        ... )
        True
    """

    eta: float | Tensor
    _bonus_totals: Tensor

    def __init__(
        self,
        dynamics: DynamicsModel,
        *,
        eta: float | Tensor = 0.1,
        weights: GainWeights = "map",
        step_size: float = 0.01,
        median_window: int = 10,
        clip: float = 10.0,
    ) -> None:
        check("weights", weights, one_of(*get_args(GainWeights)))
        for name, value in (("step_size", step_size), ("clip", clip)):
            check(name, value, ABOVE_ZERO)
        check("median_window", median_window, at_least(1))
        eta = checked_number("eta", eta, dynamics.replicas, AT_LEAST_ZERO)
        super().__init__(
            in_keys=[_REWARD, _BONUS],
            out_keys=[_REWARD],
            in_keys_inv=["observation", "action", ("next", "observation"), ("next", "terminated")],
            out_keys_inv=[_BONUS],
        )
        self.replicas = dynamics.replicas
        if isinstance(eta, Tensor):
            self.register_buffer("eta", eta, persistent=False)
        else:
            self.eta = eta
        # sum and number of the bonuses since the last report; not worth a checkpoint
        totals = dynamics.mean.new_zeros((2, *self.replicas), dtype=torch.float64)
        self.register_buffer("_bonus_totals", totals, persistent=False)
        self.dynamics = dynamics
        self.weights = weights
        self.step_size = step_size
        self.clip = clip
        self.median = RunningMedian(dynamics.replicas, median_window, dynamics.mean)
        self._generators: list[torch.Generator] | None = None

    def set_seeds(self, seeds: Sequence[int]) -> None:
        """Reseeds the random numbers of "mc" of each replica.

        Before the first call they come from torch's global generator. States do not include the
        generators.

        Args:
            seeds: one for each replica, in order; a single one for replicas=().

        Raises:
            ValueError: for a wrong number of seeds.
        """
        count = prod(self.replicas)
        if len(seeds) != count:
            raise ValueError(f"seeds must be {count}, one for each replica, got {len(seeds)}")
        device = self.dynamics.mean.device
        self._generators = [
            torch.Generator(device).manual_seed(checked_seed(seed)) for seed in seeds
        ]

    def pop_metrics(self) -> dict[str, Tensor]:
        """Returns the mean bonus of transitions stored since the last call, and resets it.

        The trainer's metric "intrinsic_reward" [*replicas]: the mean over valid transitions without
        eta; NaN if nothing was stored.
        """
        total, count = self._bonus_totals.unbind(0)
        mean = total / count
        self._bonus_totals.zero_()
        return {"intrinsic_reward": mean}

    # -- reading ----------------------------------------------------------------------------

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns a shallow copy whose reward is task reward + eta · bonus; the input stays."""
        reward, eta = tensordict.get(_REWARD), self.eta
        bonus = tensordict[_BONUS].to(reward).reshape(reward.shape)
        out = tensordict.clone(recurse=False)
        if not isinstance(eta, Tensor):
            return out.set(_REWARD, torch.add(reward, bonus, alpha=eta))
        eta = eta.to(reward).reshape(eta.shape + (1,) * (reward.ndim - eta.ndim))
        return out.set(_REWARD, torch.addcmul(reward, bonus, eta))

    # -- storing ----------------------------------------------------------------------------

    @torch.no_grad()
    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns the transitions with their bonus; ``inv`` passes a shallow copy.

        Raises:
            ValueError: the batch does not begin with the replicas.
        """
        if tensordict.get(_BONUS, None) is not None:
            return tensordict
        batch = tensordict.batch_size
        if batch[: len(self.replicas)] != self.replicas:
            raise ValueError(
                f"the batch size must begin with the replicas {list(self.replicas)}, got "
                f"{list(batch)}"
            )
        device = self.dynamics.mean.device
        observation, action, following, terminated = (
            tensordict[key].to(device) for key in self.in_keys_inv
        )
        valid = tensordict.get("valid", None)
        if valid is None:
            valid = torch.ones(batch, dtype=torch.bool)
        valid = valid.bool().reshape(batch).to(device)
        is_continuing = ~terminated.bool().reshape(batch)
        rows = [
            observation,
            self.dynamics.encode_action(action, batch),
            following,
            valid.unsqueeze(-1),
            (valid & is_continuing).unsqueeze(-1),
        ]
        rows = [entry.reshape(*self.replicas, -1, entry.shape[-1]) for entry in rows]
        bonus = self._bonus(*rows).reshape(*batch, 1)
        return tensordict.set(_BONUS, bonus.to(tensordict.device or observation.device))

    def _bonus(
        self,
        observation: Tensor,
        action: Tensor,
        following: Tensor,
        valid: Tensor,
        predicted: Tensor,
    ) -> Tensor:
        """Returns the bonus, [*replicas, rows], from entries [*replicas, rows, *]."""
        count = observation.shape[-2]
        if count == 0:
            return self.dynamics.mean.new_zeros(observation.shape[:-1])
        states = torch.cat([observation, following], -1), torch.cat([valid, predicted], -1)
        for state, states_valid in _pieces(self.replicas, *states):
            before, after = state.chunk(2, -1)
            self.dynamics.update_statistics(before, states_valid[..., 0])
            self.dynamics.update_statistics(after, states_valid[..., 1])
        noise = self._noise() if self.weights == "mc" else None
        gains = [
            information_gain(self.dynamics, *piece, noise=noise, step_size=self.step_size)
            for piece in _pieces(self.replicas, observation, action, following)
        ]
        gain = torch.cat(gains, -1)[..., :count]
        is_predicted = predicted.squeeze(-1)
        median = self.median.update(gain, is_predicted).unsqueeze(-1)
        # if more than half of the gains are 0, the other ones are clipped
        gain = gain / median.clamp_min(torch.finfo(gain.dtype).tiny)
        bonus = torch.where(is_predicted, gain.clamp_max(self.clip), 0)
        # cumsum adds from left to right, so the zeros of the padding at the end change no bit
        total = bonus.double().cumsum(-1)[..., -1]
        self._bonus_totals += torch.stack([total, valid.squeeze(-1).sum(-1).double()])
        return bonus

    def _noise(self) -> Tensor:
        """Returns standard normal noise for a weight draw, [*replicas, P]."""
        mu = self.dynamics.network.posterior.mu
        if self._generators is None:
            return torch.randn_like(mu)
        noise = mu.new_empty((len(self._generators), mu.shape[-1]))
        for row, generator in zip(noise, self._generators, strict=True):
            row.normal_(generator=generator)
        return noise.reshape(mu.shape)


def _pieces(replicas: Sequence[int], *entries: Tensor) -> Iterator[list[Tensor]]:
    """Yields entries [*replicas, rows, *] in pieces of rows.

    With more than one replica the last piece is padded. The rounding of a matrix product depends on
    its shape, and a row must not depend on how many rows another replica has.
    """
    if prod(replicas) > 1:
        missing = -entries[0].shape[-2] % _PIECE
        entries = tuple(F.pad(entry, (0, 0, 0, missing)) for entry in entries)
    yield from (list(piece) for piece in zip(*(e.split(_PIECE, -2) for e in entries), strict=True))
