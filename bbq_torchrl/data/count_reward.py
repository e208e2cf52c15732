"""A count bonus: an intrinsic reward for rarely visited states."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict.utils import unravel_key
from torch import Tensor

from bbq_torchrl.checks import COUNT, check
from bbq_torchrl.data.bonus_reward import BonusReward

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey


class CountReward(BonusReward):
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
    _codes: Tensor
    _features: Tensor

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
        super().__init__(
            kind_key,
            eta=eta,
            replicas=replicas,
            reward_key=reward_key,
            valid_key=valid_key,
            in_keys_inv=[unravel_key(("next", observation_key))],
        )
        # fixed in every run, so that hash collisions do not depend on the seed
        generator = torch.Generator().manual_seed(0)
        codes = torch.randint(2**62, features.shape, generator=generator)
        self.register_buffer("_codes", codes, persistent=False)
        self.register_buffer("_features", features, persistent=False)
        self.register_buffer("counts", torch.zeros(*self.replicas, buckets, dtype=torch.int64))

    @torch.no_grad()
    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Counts the states and returns the transitions with their buckets."""
        (kind_key,), (observation_key,) = self.out_keys_inv, self.in_keys_inv
        if tensordict.get(kind_key, None) is not None:
            return tensordict
        valid = self._valid_rows(tensordict).reshape(*self.replicas, -1)
        is_above = (tensordict[observation_key].to(self.counts.device) > 0) & self._features
        kind = ((is_above * self._codes).sum(-1) % self.counts.shape[-1]).unsqueeze(-1)
        self.counts.scatter_add_(-1, kind.reshape(valid.shape), valid.long())
        bonus = self._bonus_of(kind).reshape(valid.shape) * valid
        self._add_to_totals(bonus.sum(-1), valid.sum(-1))
        return tensordict.set(kind_key, kind.to(tensordict.device))

    def _bonus_of(self, stored: Tensor) -> Tensor:
        """Returns 1 / sqrt(n) by the counts of now, float64, in the shape of the buckets."""
        kind = stored.to(self.counts.device).reshape(*self.replicas, -1)
        return self.counts.gather(-1, kind).double().clamp_min(1).rsqrt().reshape(stored.shape)
