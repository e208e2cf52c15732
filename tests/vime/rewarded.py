"""Transitions, a VIMEReward that starts alike each time, and buffers with it."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from bbq_torchrl.vime import DynamicsModel, VIMEReward

S, A = 4, 3


BONUS, REWARD = ("next", "intrinsic_reward"), ("next", "reward")


def transitions(*batch, size=S, end=0.2):
    """Random transitions of something like CartPole."""
    action = torch.randint(A, batch)
    terminated = torch.rand(*batch, 1) < end
    return TensorDict(
        {
            "observation": torch.randn(*batch, size),
            "action": action,
            "next": {
                "observation": torch.randn(*batch, size),
                "reward": torch.randn(*batch, 1),
                "done": terminated.clone(),
                "terminated": terminated,
            },
        },
        batch,
    )


def transform(replicas=(), size=S, **settings):
    """A transform whose model starts from the same weights each time."""
    torch.manual_seed(1)
    dynamics = DynamicsModel(size, A, (16,), replicas=replicas)
    torch.seed()
    return VIMEReward(dynamics, **settings)


def buffer(transform, size=1000, batch=32):
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(size), transform=transform, batch_size=batch
    )


def going_on(td):
    return ~td["next", "terminated"].squeeze(-1)
