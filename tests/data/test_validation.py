"""Invalid transitions are refused when they are stored."""

import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.data import ReplicaReplay, validate_transitions


def transitions():
    """The last one is terminal, and nothing may follow it."""
    false = torch.zeros(3, 1, dtype=torch.bool)
    return TensorDict(
        observation=torch.zeros(3, 2),
        action=torch.tensor([0, 1, 2]),
        action_mask=torch.tensor([[True, False, False], [True, True, False], [True] * 3]),
        next=TensorDict(
            observation=torch.zeros(3, 2),
            reward=torch.zeros(3, 1),
            done=false,
            terminated=torch.tensor([[False], [False], [True]]),
            action_mask=torch.tensor([[True] * 3, [False, True, False], [False] * 3]),
        ),
    ).auto_batch_size_(1)


def at(key, row, value):
    """A copy of an entry with another value in one row."""
    entry = transitions()[key]
    entry[row] = value
    return key, entry


ONE_HOT = torch.eye(3, dtype=torch.long)


@pytest.mark.parametrize(
    ("key", "value", "row"),
    [
        (*at("observation", 1, torch.nan), 1),
        (*at(("next", "reward"), 2, torch.inf), 2),
        (*at("action", 1, 2), 1),
        (*at("action", 0, -1), 0),
        (*at("action", 2, 3), 2),
        ("action", ONE_HOT.flip(0), 0),
        ("action", ONE_HOT + ONE_HOT.roll(-1, 1), 0),
        ("action_mask", torch.ones(3, 3), ""),
        (("next", "action_mask"), torch.ones(3, 3), ""),
        (*at(("next", "action_mask"), 0, False), 0),
        # Truncated, not terminated: the value of the next state counts.
        (*at(("next", "terminated"), 2, False), 2),
    ],
)
def test_bad_transitions_are_named_and_nothing_is_stored(key, value, row):
    replay = ReplicaReplay(10, replicas=2)
    name = key if isinstance(key, str) else key[0]
    with pytest.raises(ValueError, match=rf"{name}.* replica 1 must .*{row}"):
        replay.extend([transitions(), transitions().set(key, value)])
    assert replay.lengths == (0, 0)
    replay.extend([transitions(), transitions()])


@pytest.mark.parametrize(
    "rows", [transitions().set("action", ONE_HOT), transitions().select("action")]
)
def test_one_hot_actions_and_rows_without_masks_are_understood(rows):
    validate_transitions(rows)


@pytest.mark.parametrize("shape", [(2,), (2, 1)])
def test_what_rows_without_masks_have_is_checked(shape):
    with pytest.raises(ValueError, match="2 of 2 rows"):
        validate_transitions(TensorDict(extra=torch.full(shape, torch.nan), batch_size=[2]))
