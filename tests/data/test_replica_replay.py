"""Replay buffers of several replicas: epochs, eviction, spiking, state."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from numbered_rows import KEYS, rows

from bbq_torchrl.data import ReplicaReplay


def make_replay(*lengths: int, capacity: int = 50) -> ReplicaReplay:
    replay = ReplicaReplay(capacity, replicas=len(lengths), keys=KEYS)
    replay.extend([rows(1000 * r, length) for r, length in enumerate(lengths)])
    return replay


def stored(replay: ReplicaReplay, replica: int) -> list[int]:
    return replay.buffers[replica][:]["observation"][:, 0].int().tolist()


def numbers_of(batch, replica: int) -> list[int]:
    transitions = batch.transitions[replica]
    return transitions["observation"][transitions["valid"]][:, 0].int().tolist()


def play_epoch(replay: ReplicaReplay, batch_size: int = 4) -> list[list[int]]:
    """The numbers each replica sees in an epoch, in order."""
    seen: list[list[int]] = [[] for _ in range(replay.replicas)]
    for batch in replay.epoch(batch_size):
        for replica, numbers in enumerate(seen):
            numbers += numbers_of(batch, replica)
    return seen


def test_an_epoch_shows_every_transition_of_every_replica_exactly_once():
    replay = make_replay(23, 8, 1)

    seen = play_epoch(replay)

    for replica, length in enumerate((23, 8, 1)):
        assert sorted(seen[replica]) == list(range(1000 * replica, 1000 * replica + length))


def test_batches_have_one_shape_and_say_who_is_active():
    replay = make_replay(10, 4, 5)

    batches = list(replay.epoch(4))

    assert [b.transitions.batch_size for b in batches] == [torch.Size([3, 4])] * 3
    assert [b.active for b in batches] == [
        (True, True, True),
        (True, False, True),
        (True, False, False),
    ]
    for batch in batches:
        assert batch.transitions["valid"].any(-1).tolist() == list(batch.active)


def test_padding_repeats_rows_of_the_same_replica():
    replay = make_replay(10, 3)

    for batch in replay.epoch(4):
        for replica in range(2):
            numbers = batch.transitions[replica]["observation"][:, 0]
            assert set((numbers // 1000).int().tolist()) == {replica}
            assert torch.equal(batch.transitions[replica]["next", "reward"][:, 0], 100 * numbers)


def test_only_the_chosen_entries_are_stored():
    replay = make_replay(5)

    batch = next(replay.epoch(2)).transitions

    expected = {"observation", ("next", "reward"), "valid"}
    assert set(batch.keys(True, True)) == expected


def test_epochs_and_replicas_are_shuffled_differently():
    replay = make_replay(40, 40)

    first, second = play_epoch(replay), play_epoch(replay)

    # Two of 40! orders are the same with probability 1e-48.
    orders = [first[0], second[0], [n - 1000 for n in first[1]], [n - 1000 for n in second[1]]]
    assert all(a != b for a, b in pairwise(orders))
    assert list(range(40)) not in orders


def test_a_seed_decides_the_order_whatever_was_drawn_before():
    replay, other = make_replay(40), make_replay(40)
    play_epoch(other, batch_size=7)

    for r in (replay, other):
        r.seed([5])
    orders = [[play_epoch(r), play_epoch(r)] for r in (replay, other)]

    assert orders[0] == orders[1]
    replay.seed([6])
    assert play_epoch(replay) != orders[0][0]


def test_a_replicas_order_does_not_depend_on_the_others_rows():
    ours, other = make_replay(9, 30), make_replay(41, 30)
    for replay in (ours, other):
        replay.seed([1, 2])

    for _ in range(3):
        assert play_epoch(ours)[1] == play_epoch(other)[1]


def test_the_oldest_unprotected_transitions_make_room():
    replay = make_replay(3, 5, capacity=8)
    replay.protect()
    for start in range(100, 130, 3):
        replay.extend([rows(start, 3), rows(start, 2)])

    assert replay.protected == (3, 5)
    assert replay.lengths == (8, 8)
    assert stored(replay, 0)[:3] == [0, 1, 2]
    assert sorted(stored(replay, 0)[3:]) == [125, 126, 127, 128, 129]
    assert stored(replay, 1)[:5] == [1000, 1001, 1002, 1003, 1004]
    assert sorted(stored(replay, 1)[5:]) == [125, 127, 128]


def test_of_more_rows_than_fit_the_last_are_stored():
    replay = make_replay(2, capacity=6)
    replay.protect()

    replay.extend([rows(10, 9)])

    assert sorted(stored(replay, 0)) == [0, 1, 15, 16, 17, 18]


def test_dropping_the_spike_concerns_one_replica_and_keeps_the_order_of_the_rest():
    replay = make_replay(3, 3, capacity=8)
    replay.protect()
    replay.extend([rows(100, 7), rows(100, 4)])

    replay.drop_protected(0)

    assert replay.protected == (0, 3)
    assert stored(replay, 0) == [102, 103, 104, 105, 106]
    assert stored(replay, 1) == [1000, 1001, 1002, 100, 101, 102, 103]
    replay.extend([rows(200, 5), rows(200, 1)])
    assert sorted(stored(replay, 0)) == [104, 105, 106, 200, 201, 202, 203, 204]
    replay.drop_protected(0)  # nothing is left to drop
    assert sorted(play_epoch(replay)[0]) == [104, 105, 106, 200, 201, 202, 203, 204]


def test_dropping_all_that_is_stored_leaves_an_empty_buffer():
    replay = make_replay(3)
    replay.protect()

    replay.drop_protected(0)

    assert replay.lengths == (0,)


def test_the_state_restores_rows_places_and_protection():
    replay = make_replay(3, 4, capacity=9)
    replay.protect()
    replay.extend([rows(100, 8), rows(100, 2)])
    other = ReplicaReplay(9, replicas=2, keys=KEYS)

    other.load_state_dict(replay.state_dict())

    for r in (replay, other):
        r.seed([1, 2])
        r.extend([rows(200, 2), rows(200, 4)])
    for replica in range(2):
        assert stored(other, replica) == stored(replay, replica)
    assert other.protected == replay.protected == (3, 4)
    assert play_epoch(other) == play_epoch(replay)


def test_the_state_of_an_empty_replay_empties_another():
    replay = make_replay(3)

    replay.load_state_dict(ReplicaReplay(50, keys=KEYS).state_dict())

    assert replay.lengths == (0,)


def test_a_state_that_does_not_fit_is_refused():
    state = make_replay(9, 9).state_dict()

    with pytest.raises(ValueError, match="must be of 1 replicas, got 2"):
        ReplicaReplay(50, keys=KEYS).load_state_dict(state)
    with pytest.raises(ValueError, match="must fit the capacity 8, got 9 rows"):
        ReplicaReplay(8, replicas=2, keys=KEYS).load_state_dict(state)


def test_an_epoch_that_was_overtaken_by_the_next_says_so():
    replay = make_replay(20)
    first = replay.epoch(4)
    next(first)
    next(replay.epoch(4))

    with pytest.raises(RuntimeError, match="a new epoch has begun"):
        next(first)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda replay: ReplicaReplay(0), "capacity must be at least 1, got 0"),
        (lambda replay: ReplicaReplay(5, replicas=0), "replicas must be at least 1, got 0"),
        (lambda replay: replay.epoch(0), "batch_size must be at least 1, got 0"),
        (lambda replay: replay.extend([rows(0, 1)]), "rows must be 2, one for each replica, got 1"),
        (lambda replay: replay.seed([1, 2, 3]), "seeds must be 2, one for each replica, got 3"),
        (lambda replay: replay.protect(), "fewer than the capacity 5 of the storage, got 5"),
        (
            lambda replay: ReplicaReplay(5, keys=KEYS).epoch(2),
            r"every replica needs a transition to learn from, got \(0,\)",
        ),
    ],
)
def test_wrong_calls_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong(make_replay(5, 2, capacity=5))
