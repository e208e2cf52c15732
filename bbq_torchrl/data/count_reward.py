"""A count bonus: an intrinsic reward for rarely visited states."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict.utils import unravel_key
from torch import Tensor
from torchrl.envs import EnvBase, Transform

from bbq_torchrl.bayes.replicas import checked_number
from bbq_torchrl.checks import AT_LEAST_ZERO, COUNT, check

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey


class CountReward(Transform):
    r"""Adds a bonus to each stored transition for the rarity of its next state.

    This is a transform of a replay buffer, not of an environment. The bonus is 1 / sqrt(n), where n
    is the number of stored states of the same kind (Strehl and Littman 2008, Bellemare et al.
    2016). Two states are of the same kind if the same counted features are above 0. Kinds are
    hashed into buckets (Tang et al. 2017): each feature has a random 63-bit number, and a kind is
    the sum of the numbers of features above 0.

    - Storing counts the new states and stores their buckets under ``("next", "kind")``.
    - Reading returns ``("next", "reward")`` = reward + eta / sqrt(n) with the current counts. So
      the bonus of a state fades with visits, also in transitions stored earlier.

    The stored reward is the task's, so reported rewards exclude the bonus.

    Args:
        features: the number F of features of an observation, or the mask of counted ones, bool [F].

    Keyword Args:
        eta: the bonus of a state seen once, in units of reward; a number or a tensor [*replicas].
            Defaults to 1.
        replicas: replica shape, each replica with separate counts. Defaults to ().
        buckets: the size of the table. Defaults to 65,536.
        observation_key: the state, under "next".
        reward_key: under "next", the task's reward [*batch, 1].
        valid_key: an optional entry, bool [*batch], True for valid rows.
        kind_key: under "next", the bucket, int64 [*batch, 1].

    Raises:
        ValueError: for an invalid argument, or as part of an environment.

    Examples:
        >>> from tensordict import TensorDict
        >>> transform = CountReward(2, eta=1.0)
        >>> states = torch.tensor([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        >>> rows = TensorDict({"next": {"observation": states, "reward": torch.zeros(3, 1)}}, [3])
        >>> stored = transform.inv(rows)
        >>> transform(stored)["next", "reward"].squeeze(-1)
        tensor([0.7071, 0.7071, 1.0000])
    """

    counts: Tensor
    eta: float | Tensor
    _codes: Tensor
    _features: Tensor
    _bonus_totals: Tensor

    ENV_ERR = "CountReward is a transform of replay buffers, not of an environment"

    def __init__(
        self,
        features: int | Tensor,
        *,
        eta: float | Tensor = 1.0,
        replicas: torch.Size | tuple[int, ...] = (),
        buckets: int = 65_536,
        observation_key: NestedKey = "observation",
        reward_key: NestedKey = "reward",
        valid_key: NestedKey = "valid",
        kind_key: NestedKey = "kind",
    ) -> None:
        if isinstance(features, int):
            features = torch.ones(features, dtype=torch.bool)
        if not bool(features.any()):
            raise ValueError("features must include at least one that is counted, got none")
        check("buckets", buckets, COUNT)
        self.replicas = torch.Size(replicas)
        eta = checked_number("eta", eta, self.replicas, AT_LEAST_ZERO)
        reward, kind = unravel_key(("next", reward_key)), unravel_key(("next", kind_key))
        super().__init__(
            in_keys=[reward, kind],
            out_keys=[reward],
            in_keys_inv=[unravel_key(("next", observation_key))],
            out_keys_inv=[kind],
        )
        if isinstance(eta, Tensor):
            self.register_buffer("eta", eta, persistent=False)
        else:
            self.eta = eta
        self.valid_key = valid_key
        # fixed in every run, so that hash collisions do not depend on the seed
        generator = torch.Generator().manual_seed(0)
        codes = torch.randint(2**62, features.shape, generator=generator)
        self.register_buffer("_codes", codes, persistent=False)
        self.register_buffer("_features", features, persistent=False)
        self.register_buffer("counts", torch.zeros(*self.replicas, buckets, dtype=torch.int64))
        totals = torch.zeros(2, *self.replicas, dtype=torch.float64)
        self.register_buffer("_bonus_totals", totals, persistent=False)

    def pop_metrics(self) -> dict[str, Tensor]:
        """Returns the mean bonus of transitions stored since the last call, and resets it.

        The trainer's metric "intrinsic_reward" [*replicas], without eta; NaN if nothing was stored.
        """
        total, count = self._bonus_totals.unbind(0)
        mean = total / count
        self._bonus_totals.zero_()
        return {"intrinsic_reward": mean}

    @torch.no_grad()
    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Counts the states and returns the transitions with their buckets."""
        (kind_key,) = self.out_keys_inv
        if tensordict.get(kind_key, None) is not None:
            return tensordict
        batch = tensordict.batch_size
        if batch[: len(self.replicas)] != self.replicas:
            raise ValueError(
                f"the batch size must begin with the replicas {list(self.replicas)}, got "
                f"{list(batch)}"
            )
        (observation_key,) = self.in_keys_inv
        is_above = (tensordict[observation_key].to(self.counts.device) > 0) & self._features
        kind = (is_above * self._codes).sum(-1) % self.counts.shape[-1]
        valid = tensordict.get(self.valid_key, None)
        if valid is None:
            valid = torch.ones_like(kind, dtype=torch.bool)
        rows = kind.reshape(*self.replicas, -1)
        is_counted = valid.bool().to(rows.device).reshape(rows.shape)
        self.counts.scatter_add_(-1, rows, is_counted.long())
        bonus = self.counts.gather(-1, rows).double().clamp_min(1).rsqrt() * is_counted
        self._bonus_totals += torch.stack([bonus.sum(-1), is_counted.sum(-1).double()])
        return tensordict.set(kind_key, kind.unsqueeze(-1).to(tensordict.device))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns a shallow copy whose reward is reward + eta / sqrt(n); the input is unchanged."""
        reward_key, kind_key = self.in_keys
        reward, kind = tensordict.get(reward_key), tensordict.get(kind_key, None)
        if kind is None:
            raise KeyError(
                f"{kind_key!r} is missing: the transitions were stored without this transform"
            )
        rows = kind.to(self.counts.device).reshape(*self.replicas, -1)
        bonus = self.counts.gather(-1, rows).clamp_min(1).to(reward.dtype).rsqrt()
        eta = self.eta
        bonus = bonus * (eta.to(bonus).unsqueeze(-1) if isinstance(eta, Tensor) else eta)
        out = tensordict.clone(recurse=False)
        return out.set(reward_key, reward + bonus.reshape(reward.shape).to(reward.device))

    def set_container(self, container: Transform | EnvBase) -> None:
        """Raises ValueError if the container is, or belongs to, an environment."""
        if isinstance(container, EnvBase) or container.parent is not None:
            raise ValueError(self.ENV_ERR)
        super().set_container(container)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        raise ValueError(self.ENV_ERR)
