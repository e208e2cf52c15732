"""An environment in which nothing changes: what a policy's values differ by are its weights."""

from __future__ import annotations

import torch
from q_actor import ACTIONS, FEATURES
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase


class StillEnv(EnvBase):
    """Always the same observation, every action is legal, an episode never ends."""

    def __init__(self) -> None:
        super().__init__(batch_size=())
        self.observation_spec = Composite(
            observation=Unbounded((FEATURES,)),
            action_mask=Binary(ACTIONS, (ACTIONS,), dtype=torch.bool),
        )
        self.action_spec = Categorical(ACTIONS)
        self.reward_spec = Unbounded((1,))

    def _told(self) -> TensorDict:
        return TensorDict(
            observation=torch.ones(FEATURES), action_mask=torch.ones(ACTIONS, dtype=torch.bool)
        )

    def _reset(self, _: TensorDictBase | None = None) -> TensorDict:
        return self._told()

    def _step(self, _: TensorDictBase) -> TensorDict:
        done = torch.zeros(1, dtype=torch.bool)
        return self._told().update({"reward": torch.zeros(1), "done": done})

    def _set_seed(self, seed: int | None) -> None: ...
