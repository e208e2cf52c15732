"""Environments take seeds and actions of these kinds."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.data import BootstrapMask, ReplicaReplay
from bbq_torchrl.envs import DialogueEnv
from bbq_torchrl.envs.text_channel import count_errors
from bbq_torchrl.vime import DynamicsModel, VIMEReward


@pytest.mark.parametrize("seed", [-1, 2**63, np.float64(3)])
def test_what_is_no_seed_is_refused(restaurant, seed):
    env = DialogueEnv(restaurant)
    calls = (
        lambda: DialogueEnv(restaurant, seed=seed),
        lambda: env.set_seed(seed),
        lambda: ReplicaReplay(8).seed([seed]),
        lambda: BootstrapMask(4).set_seeds([seed]),
        lambda: VIMEReward(DynamicsModel(3, 2), eta=0.5).set_seeds([seed]),
        lambda: count_errors(restaurant, 1, seed=seed),
    )
    for call in calls:
        with pytest.raises(ValueError, match="seed"):
            call()


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int32])
def test_an_action_of_any_integer_dtype_is_played(restaurant, dtype):
    told = []
    for kind in (dtype, torch.int64):
        env = DialogueEnv(restaurant, batch_size=(3,), seed=0)
        env.reset()
        action = torch.tensor([0, 7, 20], dtype=kind)
        told.append(env.step(TensorDict(action=action, batch_size=[3]))["next"])
    assert (told[0] == told[1]).all()


ONE_HOT = torch.eye(22)[:3]


@pytest.mark.parametrize(
    ("action", "got"),
    [
        (ONE_HOT.long(), r"torch.int64 of shape \[3, 22\]"),
        (ONE_HOT.bool(), r"torch.bool of shape \[3, 22\]"),
        (torch.zeros(3), r"torch.float32 of shape \[3\]"),
        (torch.zeros(3, dtype=torch.bool), r"torch.bool of shape \[3\]"),
        (torch.zeros(3, 1, dtype=torch.int64), r"torch.int64 of shape \[3, 1\]"),
        (torch.tensor([0, -1, 1]), "index"),
        (torch.tensor([0, 22, 1]), "index"),
    ],
)
def test_what_is_no_index_of_an_action_is_refused(restaurant, action, got):
    env = DialogueEnv(restaurant, batch_size=(3,), seed=0)
    env.reset()
    state = env.dialogues.clone()
    with pytest.raises((ValueError, IndexError), match=got):
        env.step(TensorDict(action=action, batch_size=[3]))
    assert (env.dialogues == state).all()
