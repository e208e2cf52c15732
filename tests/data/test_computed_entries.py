"""Entries computed for every stored transition, which epochs hand out with the others."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from numbered_rows import filled, rows

KEY = ("next", "square")


def square(transitions):
    return transitions["observation"] ** 2


def read(replay):
    return torch.cat([batch.transitions for batch in replay.epoch(32)], 1)


@pytest.mark.parametrize("lengths", [(7,), (600,), (512, 3), (1, 1025, 513)], ids=str)
def test_an_epoch_hands_out_each_transitions_own(lengths):
    replay = filled(*lengths)
    replay.compute(KEY, lambda td: -td["observation"])
    replay.compute(KEY, square)  # in the place of what was computed before
    replay.compute(("next", "reward"), lambda td: td["next", "reward"] + 1)  # of what is stored
    for _ in range(2):
        transitions = read(replay)
        assert torch.equal(transitions[KEY], transitions["observation"] ** 2)
        assert torch.equal(transitions["next", "reward"], 100 * transitions["observation"] + 1)
        assert transitions["valid"].sum(-1).tolist() == list(lengths)
    stored = replay.buffers[0][:]["next", "reward"]
    assert torch.equal(stored, rows(0, lengths[0])["next", "reward"])


@pytest.mark.parametrize(
    "change",
    [
        lambda replay: replay.extend([rows(45, 1)]),
        lambda replay: replay.drop_protected(0),
        lambda replay: replay.load_state_dict(deepcopy(replay.state_dict())),
    ],
    ids=["extend", "drop", "load"],
)
def test_it_is_gone_once_the_transitions_change(change):
    replay = filled(40)
    replay.protect()
    replay.extend([rows(40, 5)])
    replay.compute(KEY, square)
    change(replay)
    assert KEY not in read(replay).keys(include_nested=True)


def test_a_replicas_values_do_not_depend_on_anothers_length():
    """Every call has the same shape, and sees stored transitions only."""
    weight = torch.randn(2, 64, 8)
    shapes, values = [], []

    def network(transitions):
        observation = transitions["observation"]
        shapes.append(tuple(transitions.shape))
        assert ((observation % 10_000) < 1400).all()
        return torch.bmm(observation.sin().expand(-1, -1, 64), weight)

    for other in (5, 1400):
        replay = filled(90, other)
        replay.compute(KEY, network)
        values.append(read(replay)[KEY][0, :90])

    assert torch.equal(*values)
    assert shapes == [(2, 512)] * (1 + 3)
