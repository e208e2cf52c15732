"""Intrinsic rewards that a replay buffer adds to sampled rewards: their base, and a count bonus."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict.utils import unravel_key
from torch import Tensor
from torchrl.envs import EnvBase, Transform

from bbq_torchrl.bayes.replicas import checked_number
from bbq_torchrl.settings import AT_LEAST_ZERO, COUNT, check

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey


class BonusReward(Transform):
    """Adds eta · bonus to the rewards of sampled transitions; the stored reward is the task's.

    A transform of a replay buffer, not of an environment. A subclass defines ``_inv_call``, which
    stores an entry under "next" with new transitions and reports their bonuses to
    :meth:`_add_to_totals`, and, if the entry is not the bonus itself, :meth:`_bonus_of`.

    Args:
        stored_key: under "next", the entry that is stored, [*batch, 1].

    Keyword Args:
        eta: the value of a bonus of 1 in units of the task's reward; a number or [*replicas].
        replicas: the shape of the replicas.
        reward_key: under "next", the task's reward, [*batch, 1] or [*batch].
        valid_key: bool [*batch], True for valid rows; without the entry all are valid.
        in_keys_inv: the entries that storing reads.
        device: of the totals.

    Raises:
        ValueError: for an invalid ``eta``, or as part of an environment.
    """

    eta: float | Tensor
    _bonus_totals: Tensor

    def __init__(
        self,
        stored_key: NestedKey,
        *,
        eta: float | Tensor,
        replicas: Sequence[int],
        reward_key: NestedKey,
        valid_key: NestedKey,
        in_keys_inv: Sequence[NestedKey],
        device: torch.device | None = None,
    ) -> None:
        replicas = torch.Size(replicas)
        eta = checked_number("eta", eta, replicas, AT_LEAST_ZERO)
        reward, stored = unravel_key(("next", reward_key)), unravel_key(("next", stored_key))
        super().__init__(
            in_keys=[reward, stored],
            out_keys=[reward],
            in_keys_inv=list(in_keys_inv),
            out_keys_inv=[stored],
        )
        self.replicas = replicas
        self.valid_key = valid_key
        if isinstance(eta, Tensor):
            self.register_buffer("eta", eta, persistent=False)
        else:
            self.eta = eta
        # sum and number of the bonuses since the last report; not worth a checkpoint
        totals = torch.zeros((2, *replicas), dtype=torch.float64, device=device)
        self.register_buffer("_bonus_totals", totals, persistent=False)

    def pop_metrics(self) -> dict[str, Tensor]:
        """Returns the mean bonus of transitions stored since the last call, and resets it.

        The trainer's metric "intrinsic_reward" [*replicas]: the mean over valid transitions without
        eta; NaN if nothing was stored.
        """
        total, count = self._bonus_totals.unbind(0)
        mean = total / count
        self._bonus_totals.zero_()
        return {"intrinsic_reward": mean}

    def _add_to_totals(self, total: Tensor, count: Tensor) -> None:
        """Adds the sum and the number of stored bonuses, [*replicas] each, to the metric."""
        self._bonus_totals += torch.stack([total.double(), count.double()])

    def _valid_rows(self, tensordict: TensorDictBase) -> Tensor:
        """Returns which transitions are valid, bool [*batch].

        Raises:
            ValueError: the batch does not begin with the replicas.
        """
        batch = tensordict.batch_size
        if batch[: len(self.replicas)] != self.replicas:
            raise ValueError(
                f"the batch size must begin with the replicas {list(self.replicas)}, got "
                f"{list(batch)}"
            )
        device = self._bonus_totals.device
        valid = tensordict.get(self.valid_key, None)
        if valid is None:
            return torch.ones(batch, dtype=torch.bool, device=device)
        return valid.bool().reshape(batch).to(device)

    def _bonus_of(self, stored: Tensor) -> Tensor:
        """Returns the bonuses of stored entries, in their shape."""
        return stored

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns a shallow copy whose reward is task reward + eta · bonus; the input stays."""
        reward_key, stored_key = self.in_keys
        reward, stored = tensordict.get(reward_key), tensordict.get(stored_key, None)
        if stored is None:
            raise KeyError(
                f"{stored_key!r} is missing: the transitions were stored without this transform"
            )
        out = tensordict.clone(recurse=False)
        bonus, eta = self._bonus_of(stored).to(reward).reshape(reward.shape), self.eta
        if not isinstance(eta, Tensor):
            return out.set(reward_key, torch.add(reward, bonus, alpha=eta))
        eta = eta.to(reward).reshape(eta.shape + (1,) * (reward.ndim - eta.ndim))
        return out.set(reward_key, torch.addcmul(reward, bonus, eta))

    def set_container(self, container: Transform | EnvBase) -> None:
        """Raises ValueError if the container is, or belongs to, an environment."""
        if isinstance(container, EnvBase) or container.parent is not None:
            raise ValueError(self._env_error())
        super().set_container(container)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        raise ValueError(self._env_error())

    def _env_error(self) -> str:
        return (
            f"{type(self).__name__} is a transform of replay buffers, not of an environment, whose "
            "transforms do not see whole transitions"
        )


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
