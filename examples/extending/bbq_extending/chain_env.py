"""The N-chain (Osband et al. 2016), a batch of walks in lockstep."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictBase


class ChainEnv(EnvBase):
    """A walk of N + 9 steps along N states, from the second one, to the left (0) or right (1).

    A step that ends in the first state has a little reward, one that ends in the last state a large
    one. Success is to have been in the last state. The observation has a 1 for the state and for
    each one before it.

    Args:
        length: N, the states.
        batch_size: of the walks.

    Keyword Args:
        near_reward: of the first state.
        far_reward: of the last one.
        device: where the walks are.

    Examples:
        >>> env = ChainEnv(5, batch_size=(2, 3))
        >>> right = lambda td: td.set("action", torch.ones(2, 3, dtype=torch.int64))
        >>> rollout = env.rollout(14, right)
        >>> rollout["next", "reward"].sum(-2).flatten().unique()
        tensor([12.])
    """

    def __init__(
        self,
        length: int,
        batch_size: Sequence[int] = (),
        *,
        near_reward: float = 0.001,
        far_reward: float = 1.0,
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(device=device, batch_size=torch.Size(batch_size))
        self.length, self.steps = length, length + 9
        self.near_reward, self.far_reward = near_reward, far_reward
        batch, one = self.batch_size, (*self.batch_size, 1)
        self._state = torch.ones(batch, dtype=torch.int64, device=self.device)
        self._step_count = torch.zeros_like(self._state)
        self._success = torch.zeros_like(self._state, dtype=torch.bool)
        flag = Binary(1, one, device=self.device, dtype=torch.bool)
        self.observation_spec = Composite(
            observation=Bounded(0, 1, (*batch, length), device=self.device, dtype=torch.float32),
            success=flag,
            shape=batch,
        )
        self.action_spec = Categorical(2, batch, device=self.device, dtype=torch.int64)
        self.reward_spec = Unbounded(one, device=self.device, dtype=torch.float32)
        self.done_spec = Composite(
            done=flag.clone(), terminated=flag.clone(), truncated=flag.clone(), shape=batch
        )

    def _set_seed(self, seed: int | None) -> None:
        """Does nothing: the chain is deterministic."""

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        which = None if tensordict is None else tensordict.get("_reset", None)
        begins = torch.ones_like(self._success) if which is None else which.squeeze(-1)
        self._state = torch.where(begins, 1, self._state)
        self._step_count = torch.where(begins, 0, self._step_count)
        self._success = self._success & ~begins
        return self._observed()

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        last = self.length - 1
        self._state = (self._state + 2 * tensordict["action"] - 1).clamp(0, last)
        self._step_count = self._step_count + 1
        is_far = self._state == last
        self._success = self._success | is_far
        reward = self.far_reward * is_far.float()
        reward = reward + self.near_reward * (self._state == 0).float()
        return self._observed().set("reward", reward.unsqueeze(-1))

    def _observed(self) -> TensorDict:
        states = torch.arange(self.length, device=self.device)
        done = (self._step_count >= self.steps).unsqueeze(-1)
        return TensorDict(
            {
                "observation": (states <= self._state.unsqueeze(-1)).float(),
                "success": self._success.unsqueeze(-1),
                "done": done,
                "terminated": done.clone(),
                "truncated": torch.zeros_like(done),
            },
            batch_size=self.batch_size,
            device=self.device,
        )
