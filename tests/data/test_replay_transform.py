"""Transforms of a replica replay: what they add is stored, what they change is only read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import torch
from numbered_rows import KEYS, rows
from torchrl.envs import Compose, Transform

from bbq_torchrl.data import ReplicaReplay

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictBase


class Novelty(Transform):
    """Stores how many rows of the replica came before, and adds that to the reward when read."""

    def __init__(self, replicas: int) -> None:
        super().__init__(out_keys_inv=[("next", "novelty")])
        self.register_buffer("seen", torch.zeros(replicas, 1))
        self.seeds: tuple[int, ...] = ()

    def set_seeds(self, seeds: Sequence[int]) -> None:
        self.seeds = tuple(seeds)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        valid = tensordict["valid"].float()
        tensordict["next", "novelty"] = (self.seen + valid.cumsum(-1) - 1).unsqueeze(-1)
        self.seen += valid.sum(-1, keepdim=True)
        return tensordict

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        total = tensordict["next", "reward"] + tensordict["next", "novelty"]
        return tensordict.set(("next", "reward"), total)


class Sign(Transform):
    def __init__(self) -> None:
        super().__init__(out_keys_inv=["is_positive"])

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("is_positive", tensordict["observation"] > 0)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict


def filled(*lengths: int, capacity: int = 20) -> ReplicaReplay:
    replay = ReplicaReplay(
        capacity, replicas=len(lengths), keys=KEYS, transform=Novelty(len(lengths))
    )
    replay.extend([rows(1000 * r, length) for r, length in enumerate(lengths)])
    return replay


def test_what_the_transform_adds_is_stored_and_the_reward_stays_as_it_was():
    replay = filled(5, 2)
    replay.extend([rows(5, 1), rows(1002, 3)])

    for replica, length in enumerate((6, 5)):
        stored = replay.buffers[replica][:]
        assert stored["next", "novelty"].flatten().tolist() == list(range(length))
        expected = [100.0 * (1000 * replica + i) for i in range(length)]
        assert stored["next", "reward"].flatten().tolist() == expected


def test_what_is_read_is_transformed_in_every_epoch_once():
    replay = filled(5, 2)

    for _ in range(3):
        for batch in replay.epoch(2):
            transitions = batch.transitions[batch.transitions["valid"]]
            expected = 100 * transitions["observation"] + transitions["observation"] % 1000
            assert torch.equal(transitions["next", "reward"], expected)


def test_a_state_holds_the_transforms():
    replay = filled(5, 2)
    state = replay.state_dict()
    other = ReplicaReplay(20, replicas=2, keys=KEYS, transform=Novelty(2))

    other.load_state_dict(state)

    assert other.transform.seen.flatten().tolist() == [5, 2]
    assert other.buffers[1][:]["next", "novelty"].flatten().tolist() == [0, 1]


@pytest.mark.parametrize("has_transform", [False, True])
def test_a_state_of_another_transform_is_refused(has_transform: bool):
    state = filled(5, 2).state_dict()
    if has_transform:
        del state["transform"]
    other = ReplicaReplay(
        20, replicas=2, keys=KEYS, transform=Novelty(2) if has_transform else None
    )

    with pytest.raises(ValueError, match="the same transform"):
        other.load_state_dict(state)


def test_every_part_of_a_composed_transform_runs_and_is_seeded():
    novelty = Novelty(2)
    replay = ReplicaReplay(20, replicas=2, keys=KEYS, transform=Compose(novelty, Sign()))

    replay.seed([7, 8])
    replay.extend([rows(0, 2), rows(0, 1)])

    assert novelty.seeds == (7, 8)
    assert replay.buffers[0][:]["is_positive"].flatten().tolist() == [False, True]
    assert replay.buffers[1][:]["next", "novelty"].flatten().tolist() == [0]


def test_what_is_added_goes_along_when_protected_rows_are_dropped():
    replay = filled(3)
    replay.protect()
    replay.extend([rows(3, 2)])

    replay.drop_protected(0)

    assert replay.buffers[0][:]["next", "novelty"].flatten().tolist() == [3, 4]
