"""Entries computed for every stored transition, which epochs hand out with the others."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from numbered_rows import KEYS, rows

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.data.rows import map_stored_rows

KEY = ("next", "square")


def filled(*lengths: int, capacity: int = 2000) -> ReplicaReplay:
    replay = ReplicaReplay(capacity, replicas=len(lengths), keys=KEYS)
    replay.extend([rows(10_000 * r, length) for r, length in enumerate(lengths)])
    return replay


def square(transitions):
    return transitions["observation"] ** 2


def read(replay, batch_size=32):
    batches = [batch.transitions for batch in replay.epoch(batch_size)]
    valid = torch.cat([batch["valid"] for batch in batches], 1)
    return torch.cat(batches, 1), valid


@pytest.mark.parametrize("lengths", [(7,), (600,), (512, 3), (1, 1025, 513)], ids=str)
def test_an_epoch_hands_out_each_transitions_own(lengths):
    replay = filled(*lengths)

    replay.compute(KEY, square)
    for _ in range(2):
        transitions, valid = read(replay)
        assert torch.equal(transitions[KEY], transitions["observation"] ** 2)
        assert valid.sum(-1).tolist() == list(lengths)


def test_computing_again_replaces_and_a_stored_entry_can_be_overlaid():
    replay = filled(40, 30)
    replay.compute(KEY, square)
    replay.compute(KEY, lambda td: -td["observation"])
    replay.compute(("next", "reward"), lambda td: td["next", "reward"] + 1)

    transitions, _ = read(replay)

    assert torch.equal(transitions[KEY], -transitions["observation"])
    assert torch.equal(transitions["next", "reward"], 100 * transitions["observation"] + 1)
    assert torch.equal(replay.buffers[0][:]["next", "reward"], rows(0, 40)["next", "reward"])


@pytest.mark.parametrize("change", ["extend", "drop", "load"])
def test_it_is_gone_once_the_transitions_change(change):
    replay = filled(40)
    replay.protect()
    replay.extend([rows(40, 5)])
    replay.compute(KEY, square)
    if change == "extend":
        replay.extend([rows(45, 1)])
    elif change == "drop":
        replay.drop_protected(0)
    else:
        replay.load_state_dict(deepcopy(replay.state_dict()))

    transitions, _ = read(replay)

    assert KEY not in transitions.keys(include_nested=True)
    assert KEY not in replay.stored_keys


def test_every_call_has_the_same_shape_and_sees_only_stored_transitions():
    shapes = []

    def watched(transitions):
        shapes.append(tuple(transitions.shape))
        stored = transitions["observation"]
        assert ((stored % 10_000) < 1100).all()
        return stored

    map_stored_rows(filled(1100, 9).buffers, watched)
    assert shapes == [(2, 512)] * 3


def test_a_replicas_values_do_not_depend_on_anothers_length():
    weight = torch.randn(2, 64, 8)

    def network(transitions):
        return torch.bmm(transitions["observation"].sin().expand(-1, -1, 64), weight)

    alone, beside = filled(90, 5), filled(90, 1400)
    expected = map_stored_rows(alone.buffers, network)[0, :90]
    assert torch.equal(map_stored_rows(beside.buffers, network)[0, :90], expected)


def test_computing_for_nothing_is_refused():
    with pytest.raises(ValueError, match="every replica needs a transition"):
        ReplicaReplay(10, keys=KEYS).compute(KEY, square)
