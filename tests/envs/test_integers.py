"""Integers of NumPy and of other widths, as seeds, counts and actions."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.bayes import BayesConv2d
from bbq_torchrl.data import BootstrapMask, ReplicaReplay
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, SequencePolicy
from bbq_torchrl.envs.text_channel import count_errors
from bbq_torchrl.utils.seeds import derive_seed
from bbq_torchrl.vime import DynamicsModel, VIMEReward

INTEGERS = [np.int64, np.uint8, np.int32, torch.tensor]


def first_goals(env):
    return env.reset()["goal_id"].flatten().tolist()


@pytest.mark.parametrize("of", INTEGERS)
def test_any_integer_is_a_seed_a_size_and_a_round(restaurant, of):
    schedule = ExtensionSchedule(start=of(1), every=of(2))
    plain = DialogueEnv(restaurant, batch_size=(5,), seed=3, schedule=ExtensionSchedule(1, 2))
    env = DialogueEnv(restaurant, batch_size=(of(5),), seed=of(3), schedule=schedule)
    goals = first_goals(plain)
    assert first_goals(env) == goals
    env.set_seed(of(3))
    env.set_round(of(4))
    plain.set_round(4)
    assert first_goals(env) == goals
    assert torch.equal(env.active_slots, plain.active_slots)


@pytest.mark.parametrize("of", INTEGERS)
def test_other_parts_take_any_integer_as_a_seed(restaurant, of):
    assert derive_seed(of(3), "collect", of(1)) == derive_seed(3, "collect", 1)
    mask, plain = BootstrapMask(4), BootstrapMask(4)
    mask.set_seeds([of(3)])
    plain.set_seeds([3])
    assert torch.equal(mask.generator_state, plain.generator_state)
    ReplicaReplay(8).seed([of(3)])
    VIMEReward(DynamicsModel(3, 2), eta=0.5).set_seeds([of(3)])
    assert BayesConv2d(of(2), of(3), of(3)).kernel_size == (3, 3)


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


@pytest.fixture
def begun(restaurant):
    """Three dialogues."""
    env = DialogueEnv(restaurant, batch_size=(3,), seed=0)
    env.reset()
    return env


ONE_HOT = torch.eye(22)[:3]


@pytest.mark.parametrize(
    ("action", "got"),
    [
        (ONE_HOT.long(), r"torch.int64 of shape \[3, 22\]"),
        (ONE_HOT.bool(), r"torch.bool of shape \[3, 22\]"),
        (torch.zeros(3), r"torch.float32 of shape \[3\]"),
        (torch.zeros(3, dtype=torch.bool), r"torch.bool of shape \[3\]"),
        (torch.zeros(3, 1, dtype=torch.int64), r"torch.int64 of shape \[3, 1\]"),
    ],
    ids=["one-hot", "bool one-hot", "float", "bool", "column"],
)
def test_an_action_that_is_no_index_is_refused(begun, action, got):
    with pytest.raises(ValueError, match=rf"action .*{got}"):
        begun.step(TensorDict(action=action, batch_size=[3]))


@pytest.mark.parametrize("action", [-1, 22])
def test_an_index_of_no_action_is_refused(begun, action):
    state = begun.dialogues.clone()
    with pytest.raises(IndexError):
        begun.step(TensorDict(action=torch.tensor([0, action, 1]), batch_size=[3]))
    assert (begun.dialogues == state).all()


def test_a_script_takes_any_integers_and_refuses_others():
    turns = TensorDict(turns=torch.tensor([[0], [1]]), batch_size=[2])
    for actions in ([np.int32(4), np.uint8(2)], np.array([4, 2]), torch.tensor([4, 2])):
        assert SequencePolicy(actions)(turns.clone())["action"].tolist() == [4, 2]
    with pytest.raises(TypeError):
        SequencePolicy([1.5])
