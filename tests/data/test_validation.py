"""Transitions that could not be learned from are refused when they are stored."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.data import ReplicaReplay, validate_transitions


def transitions() -> TensorDict:
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


def test_one_hot_actions_are_understood():
    good = transitions().set("action", torch.eye(3, dtype=torch.long))
    validate_transitions(good)

    bad = good.set("action", torch.eye(3, dtype=torch.long).flip(0))
    with pytest.raises(ValueError, match="allowed by action_mask, but row 0"):
        validate_transitions(bad)

    two = transitions().set("action", torch.tensor([[1, 0, 0], [0, 1, 0], [1, 1, 0]]))
    with pytest.raises(ValueError, match="allowed by action_mask, but row 2"):
        validate_transitions(two)


@pytest.mark.parametrize(
    ("key", "row", "value", "message"),
    [
        ("observation", 1, torch.nan, r"observation of replica 1 must be finite, but row 1 .*1 of"),
        (("next", "reward"), 2, torch.inf, "next/reward of replica 1 must be finite, but row 2"),
        ("action", 1, 2, "action of replica 1 must be allowed by action_mask, but row 1"),  # masked
        ("action", 0, -1, "action of replica 1 must be allowed by action_mask, but row 0"),
        ("action", 2, 3, "action of replica 1 must be allowed by action_mask, but row 2"),
        (("next", "action_mask"), 0, False, "some action where the row is not terminated, but row"),
        # Truncated, not terminated: the value of the next state counts.
        (("next", "terminated"), 2, False, "must allow some action .*, but row 2"),
    ],
)
def test_bad_transitions_are_named_and_nothing_is_stored(key, row, value, message):
    bad = transitions()
    bad[key][row] = value
    replay = ReplicaReplay(10, replicas=2)

    with pytest.raises(ValueError, match=message):
        replay.extend([transitions(), bad])

    assert replay.lengths == (0, 0)
    replay.extend([transitions(), transitions()])


@pytest.mark.parametrize("key", ["action_mask", ("next", "action_mask")])
def test_a_mask_of_another_dtype_is_refused(key):
    bad = transitions()
    bad[key] = bad[key].byte()
    with pytest.raises(ValueError, match="action_mask of transitions must be bool, got"):
        validate_transitions(bad)


def test_transitions_without_masks_are_checked_for_what_they_have():
    validate_transitions(TensorDict(action=torch.zeros(2, dtype=torch.long), batch_size=[2]))
    with pytest.raises(ValueError, match="2 of 2 rows"):
        validate_transitions(TensorDict(observation=torch.full((2, 1), torch.nan), batch_size=[2]))
