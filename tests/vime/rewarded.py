"""Transitions, a VIMEReward that starts alike each time, and buffers with it."""

from __future__ import annotations

import q_transitions
import torch
from q_transitions import ACTIONS, FEATURES
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from bbq_torchrl.vime import DynamicsModel, VIMEReward

BONUS, REWARD = ("next", "intrinsic_reward"), ("next", "reward")


def transitions(*batch, size=FEATURES, ends=0.2):
    """Random transitions of any batch."""
    return q_transitions.transitions((), batch, features=size, ends=ends)


def transform(replicas=(), size=FEATURES, **settings):
    """A transform whose model starts from the same weights each time."""
    torch.manual_seed(1)
    dynamics = DynamicsModel(size, ACTIONS, (16,), replicas=replicas)
    torch.seed()
    return VIMEReward(dynamics, **settings)


def buffer(transform, size=1000, batch=32):
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(size), transform=transform, batch_size=batch
    )


def going_on(td):
    return ~td["next", "terminated"].squeeze(-1)
