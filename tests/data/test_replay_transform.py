"""Transforms of a replica replay: what they add is stored, what they change is only read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import torch
from numbered_rows import KEYS, filled, rows
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

    def pop_metrics(self) -> dict[str, torch.Tensor]:
        return {"seen": self.seen.flatten()}

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


def novelty_of(replay: ReplicaReplay, replica: int) -> list[int]:
    return replay.buffers[replica][:]["next", "novelty"].flatten().tolist()


def test_what_is_added_is_stored_and_what_is_changed_only_read():
    replay = filled(5, 2, transform=Novelty(2))
    replay.extend([rows(5, 1), rows(10_002, 3)])

    for replica, length in enumerate((6, 5)):
        assert novelty_of(replay, replica) == list(range(length))
        expected = 100 * rows(10_000 * replica, length)["observation"]
        assert torch.equal(replay.buffers[replica][:]["next", "reward"], expected)
    for _ in range(3):
        for batch in replay.epoch(2):
            transitions = batch.transitions[batch.transitions["valid"]]
            expected = 100 * transitions["observation"] + transitions["observation"] % 10_000
            assert torch.equal(transitions["next", "reward"], expected)


def test_it_goes_along_in_a_state_and_when_protected_rows_are_dropped():
    replay = filled(3, 2, transform=Novelty(2))
    replay.protect()
    replay.extend([rows(3, 2), rows(0, 0)])
    other = ReplicaReplay(2000, replicas=2, keys=KEYS, transform=Novelty(2))

    other.load_state_dict(replay.state_dict())
    other.drop_protected(0)

    assert other.transform.seen.flatten().tolist() == [5, 2]
    assert [novelty_of(other, replica) for replica in (0, 1)] == [[3, 4], [0, 1]]


@pytest.mark.parametrize("transforms", [(Novelty(2), None), (None, Novelty(2))])
def test_a_state_of_another_transform_is_refused(transforms):
    ours, theirs = (ReplicaReplay(9, replicas=2, keys=KEYS, transform=t) for t in transforms)

    with pytest.raises(ValueError, match="the same transform"):
        ours.load_state_dict(theirs.state_dict())


def test_every_part_of_a_composed_transform_runs_is_seeded_and_asked_for_metrics():
    novelty = Novelty(2)
    replay = ReplicaReplay(20, replicas=2, keys=KEYS, transform=Compose(novelty, Sign()))

    replay.seed([7, 8])
    replay.extend([rows(0, 2), rows(0, 1)])

    assert novelty.seeds == (7, 8)
    assert replay.pop_metrics()["seen"].tolist() == [2, 1]
    assert replay.buffers[0][:]["is_positive"].flatten().tolist() == [False, True]
    assert novelty_of(replay, 1) == [0]
