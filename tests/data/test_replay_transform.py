"""Transforms of a replica replay: what they add is stored, what they change is only read."""

from __future__ import annotations

import pytest
import torch
from numbered_rows import KEYS, rows
from tensordict import TensorDict
from torchrl.envs import Compose, RewardScaling, Transform

from bbq_torchrl.data import BootstrapMask, ReplicaReplay


class Measured(Transform):
    def pop_metrics(self):
        return {"novelty": torch.tensor([1.0, 2.0])}


def replay_with(*transforms):
    """A replay of two replicas, with one transform or three in a row."""
    doubled = RewardScaling(0.0, 2.0, in_keys=[("next", "reward")])
    three = Compose(BootstrapMask(8, replicas=2), doubled, Measured())
    (transform,) = transforms or (three,)
    return ReplicaReplay(2000, replicas=2, keys=KEYS, transform=transform)


def masks_of(seed, count):
    mask = BootstrapMask(8)
    mask.set_seeds([seed])
    return mask.inv(TensorDict(batch_size=[count]))["bootstrap_mask"]


def test_every_part_adds_what_is_stored_and_changes_what_is_read():
    replay = replay_with()
    replay.seed([7, 8])
    replay.extend([rows(0, 5), rows(0, 2)])
    replay.protect()
    replay.extend([rows(5, 1), rows(2, 3)])

    assert replay.pop_metrics()["novelty"].tolist() == [1, 2]
    for replica, length in enumerate((6, 5)):
        masks, stored = masks_of(7 + replica, length), replay.buffers[replica][:]
        assert torch.equal(stored["bootstrap_mask"], masks)
        assert torch.equal(stored["next", "reward"], 100 * stored["observation"])
        for batch in [*replay.epoch(2), *replay.epoch(2)]:
            read = batch.transitions[replica]
            assert torch.equal(read["next", "reward"], 200 * read["observation"])
            assert torch.equal(read["bootstrap_mask"], masks[read["observation"][:, 0].int()])

    # both go along in a state, and what was added stays where protected rows are dropped
    other = replay_with()
    other.load_state_dict(replay.state_dict())
    other.drop_protected(0)
    other.extend([rows(6, 3), rows(5, 4)])
    assert torch.equal(other.buffers[0][:]["bootstrap_mask"], masks_of(7, 9)[5:])
    assert torch.equal(other.buffers[1][:]["bootstrap_mask"], masks_of(8, 9))


@pytest.mark.parametrize("transforms", [(Measured(), None), (None, Measured())])
def test_a_state_of_another_transform_is_refused(transforms):
    ours, theirs = (replay_with(each) for each in transforms)
    with pytest.raises(ValueError, match="the same transform"):
        ours.load_state_dict(theirs.state_dict())
