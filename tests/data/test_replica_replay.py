"""Replay buffers of several replicas: epochs, eviction, spiking, state."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from numbered_rows import KEYS, filled, rows, stored

from bbq_torchrl.data import ReplicaReplay


def play_epoch(replay: ReplicaReplay, batch_size: int = 4) -> list[list[int]]:
    """The numbers each replica sees in an epoch, in order, from 0."""
    seen: list[list[int]] = [[] for _ in range(replay.replicas)]
    for batch in replay.epoch(batch_size):
        for numbers, own in zip(seen, batch.transitions.unbind(0), strict=True):
            numbers += (own["observation"][own["valid"]][:, 0] % 10_000).int().tolist()
    return seen


def test_an_epoch_shows_every_transition_once_in_batches_of_one_shape():
    lengths = (23, 8, 1)
    replay = filled(*lengths)

    for seen, length in zip(play_epoch(replay), lengths, strict=True):
        assert sorted(seen) == list(range(length))
    for number, (transitions, active) in enumerate(replay.epoch(4)):
        assert transitions.batch_size == torch.Size([3, 4])
        assert set(transitions.keys(True, True)) == {*KEYS, "valid"}
        assert active == tuple(4 * number < length for length in lengths)
        assert transitions["valid"].any(-1).tolist() == list(active)
        # what pads a batch is a row of the same replica
        owner = transitions["observation"][..., 0] // 10_000
        assert torch.equal(owner, torch.arange(3.0).unsqueeze(-1).expand(3, 4))
        assert torch.equal(transitions["next", "reward"], 100 * transitions["observation"])


def test_a_seed_decides_the_order_whatever_was_drawn_before_and_others_hold():
    replay, other = filled(40, 40), filled(40, 9)
    play_epoch(other, batch_size=7)

    for r in (replay, other):
        r.seed([5, 6])
    first, second = play_epoch(replay), play_epoch(replay)
    again = [play_epoch(other)[0], play_epoch(other)[0]]

    assert again == [first[0], second[0]]
    # Two of 40! orders are the same with probability 1e-48.
    orders = [first[0], second[0], first[1], second[1], list(range(40))]
    assert all(a != b for a, b in pairwise([*orders, first[0]]))
    replay.seed([7, 6])
    assert play_epoch(replay)[0] != first[0]


def test_the_oldest_unprotected_transitions_make_room():
    replay = filled(3, 5, capacity=8)
    replay.protect()
    for start in range(100, 130, 3):
        replay.extend([rows(start, 3), rows(start, 2)])

    assert replay.protected == (3, 5)
    assert replay.lengths == (8, 8)
    assert stored(replay, 0)[:3] == [0, 1, 2]
    assert sorted(stored(replay, 0)[3:]) == [125, 126, 127, 128, 129]
    assert stored(replay, 1)[:5] == list(range(10_000, 10_005))
    assert sorted(stored(replay, 1)[5:]) == [125, 127, 128]
    replay.extend([rows(200, 9), rows(0, 0)])  # more than fit: the last are stored
    assert sorted(stored(replay, 0)) == [0, 1, 2, 204, 205, 206, 207, 208]


def test_dropping_the_spike_concerns_one_replica_and_keeps_the_order_of_the_rest():
    replay = filled(3, 3, capacity=8)
    replay.protect()
    replay.extend([rows(100, 7), rows(100, 4)])

    replay.drop_protected(0)

    assert replay.protected == (0, 3)
    assert stored(replay, 0) == [102, 103, 104, 105, 106]
    assert stored(replay, 1) == [10_000, 10_001, 10_002, 100, 101, 102, 103]
    replay.extend([rows(200, 5), rows(200, 1)])
    replay.drop_protected(0)  # nothing is left to drop
    assert sorted(stored(replay, 0)) == [104, 105, 106, 200, 201, 202, 203, 204]
    only_spiked = filled(3)
    only_spiked.protect()
    only_spiked.drop_protected(0)
    assert only_spiked.lengths == (0,)


def test_a_state_that_is_restored_takes_the_place_of_all_rows():
    """All else of a state, tests/trainers/test_resume.py compares."""
    replay = filled(3, 4)
    replay.load_state_dict(ReplicaReplay(9, replicas=2, keys=KEYS).state_dict())
    assert replay.lengths == (0, 0)


@pytest.mark.parametrize("capacity", [4, 12])
def test_a_full_state_of_another_capacity_is_refused_and_nothing_is_changed(capacity):
    replay, full = filled(2, 3, capacity=capacity), filled(4, 5, capacity=8)
    full.extend([rows(0, 0), rows(100, 5)])  # the second replica has gone round
    before = [stored(replay, replica) for replica in (0, 1)]

    with pytest.raises(ValueError, match=f"of capacity {capacity}, got one of capacity 8$"):
        replay.load_state_dict(full.state_dict())

    assert [stored(replay, replica) for replica in (0, 1)] == before


def test_a_state_that_is_not_full_fits_another_capacity():
    for capacity in (7, 12):
        replay = ReplicaReplay(capacity, replicas=2, keys=KEYS)
        replay.load_state_dict(filled(7, 3, capacity=9).state_dict())
        replay.extend([rows(100, 2), rows(100, 2)])
        newest = [5, 6, 100, 101]
        index = replay.buffers[0].writer.oldest_first()
        assert replay.buffers[0][index]["observation"][:, 0].tolist()[-4:] == newest
        assert stored(replay, 1) == [10_000, 10_001, 10_002, 100, 101]


def test_what_cannot_be_protected_in_all_replicas_is_protected_in_none():
    replay = ReplicaReplay(5, replicas=2, keys=KEYS)
    replay.extend([rows(0, 3), rows(0, 5)])
    with pytest.raises(ValueError, match="fewer than the capacity 5 of the storage, got 5"):
        replay.protect()
    assert replay.protected == (0, 0)


def test_an_entry_that_the_rows_lack_is_named():
    lacking = rows(0, 3).exclude(("next", "reward"))
    replay = ReplicaReplay(5, replicas=2, keys=KEYS)
    with pytest.raises(KeyError, match=r"lack \('next', 'reward'\), .* give it keys=\[\.\.\.\]"):
        replay.extend([rows(0, 3), lacking])
    assert replay.lengths == (0, 0)


EMPTY = r"every replica needs a transition to learn from, got \(0,\)"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda replay: ReplicaReplay(0), "capacity must be at least 1, got 0"),
        (lambda replay: ReplicaReplay(5, replicas=0), "replicas must be at least 1, got 0"),
        (lambda replay: replay.epoch(0), "batch_size must be at least 1, got 0"),
        (lambda replay: replay.extend([rows(0, 1)]), "a list of 2 TensorDicts, .*, got list of 1"),
        (lambda replay: replay.extend(rows(0, 2)), "one for each replica, got TensorDict of 2"),
        (lambda replay: replay.seed([1, 2, 3]), "seeds must be 2, one for each replica, got 3"),
        (lambda replay: replay.protect(), "fewer than the capacity 5 of the storage, got 5"),
        (lambda replay: ReplicaReplay(5).epoch(2), EMPTY),
        (lambda replay: ReplicaReplay(5).compute("x", abs), EMPTY),
        (
            lambda replay: ReplicaReplay(5).load_state_dict(replay.state_dict()),
            "must be of 1 replicas, got 2",
        ),
        (
            lambda replay: replay.load_state_dict(filled(9, 9).state_dict()),
            "must be of capacity 5, got one of capacity 9 or more",
        ),
    ],
)
def test_wrong_calls_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong(filled(5, 2, capacity=5))
