"""Replay buffers of several replicas: epochs, eviction, spiking, state."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
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
    replay.seed([7, 6])
    orders = [first[0], second[0], first[1], second[1], list(range(40)), play_epoch(replay)[0]]
    assert all(a != b for a, b in pairwise([*orders, first[0]]))


COUNTS = st.integers(0, 7)
ACTS = st.one_of(
    st.tuples(st.just("extend"), st.tuples(COUNTS, COUNTS)),
    st.tuples(st.just("drop"), st.integers(0, 1)),
    st.sampled_from([("protect", None), ("restore", None)]),
)


@settings(max_examples=40, deadline=None)
@given(st.lists(ACTS, max_size=8))
def test_each_replica_keeps_what_is_protected_and_the_newest_of_the_rest(acts):
    """Against two lists for each replica, whatever is done to them in whatever order."""
    replay, capacity, written = filled(3, 1, capacity=5), 5, 100
    kept, newest = [[], []], [[0, 1, 2], [10_000]]
    for act, given_to in acts:
        if act == "extend":
            replay.extend([rows(written, count) for count in given_to])
            for r, count in enumerate(given_to):
                newest[r] += range(written, written + count)
                newest[r] = newest[r][-(capacity - len(kept[r])) :]
            written += 10
        elif act == "drop":
            replay.drop_protected(given_to)
            kept[given_to] = []
        elif act == "restore":
            state = replay.state_dict()
            if max(replay.lengths) < 5:  # what is not full fits another capacity
                capacity = 12 - capacity
            replay = filled(1, 4, capacity=capacity)
            replay.load_state_dict(state)
        elif max(replay.lengths) < capacity:
            replay.protect()
            kept, newest = [kept[r] + newest[r] for r in (0, 1)], [[], []]

        assert replay.protected == tuple(map(len, kept))
        for r, buffer in enumerate(replay.buffers):
            numbers = stored(replay, r)
            assert numbers[: len(kept[r])] == kept[r]
            assert [numbers[index] for index in buffer.writer.oldest_first()] == newest[r]


def gone_round(capacity: int) -> dict:
    """A state whose second replica has written over its first rows."""
    replay = filled(2, 3, capacity=capacity)
    replay.extend([rows(0, 0), rows(100, capacity - 1)])
    return replay.state_dict()


EMPTY = r"every replica needs a transition to learn from, got \(0,\)"
LACKING = rows(0, 3).exclude(("next", "reward"))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda replay: ReplicaReplay(0), "capacity must be at least 1, got 0"),
        (lambda replay: ReplicaReplay(5, replicas=0), "replicas must be at least 1, got 0"),
        (lambda replay: replay.epoch(0), "batch_size must be at least 1, got 0"),
        (lambda replay: replay.extend([rows(0, 1)]), "a list of 2 TensorDicts, .*, got list of 1"),
        (lambda replay: replay.extend(rows(0, 2)), "one for each replica, got TensorDict of 2"),
        (lambda replay: replay.extend([rows(0, 3), LACKING]), r"lack .*, .* give it keys=\[\.\.\."),
        (lambda replay: replay.seed([1, 2, 3]), "seeds must be 2, one for each replica, got 3"),
        (lambda replay: replay.protect(), "fewer than the capacity 5 of the storage, got 5"),
        (lambda replay: ReplicaReplay(5).epoch(2), EMPTY),
        (lambda replay: ReplicaReplay(5).compute("x", abs), EMPTY),
        (lambda replay: replay.load_state_dict(filled(1).state_dict()), "of 2 replicas, got 1"),
        (
            lambda replay: replay.load_state_dict(filled(9, 9).state_dict()),
            "must be of capacity 5, got one of capacity 9 or more",
        ),
        (lambda replay: replay.load_state_dict(gone_round(4)), "got one of capacity 4['\"]?$"),
        (lambda replay: replay.load_state_dict(gone_round(8)), "got one of capacity 8['\"]?$"),
    ],
)
def test_wrong_calls_are_refused_and_change_nothing(wrong, message):
    replay = filled(2, 5, capacity=5)
    before = [stored(replay, replica) for replica in (0, 1)]
    with pytest.raises((ValueError, KeyError), match=message):
        wrong(replay)
    assert [stored(replay, replica) for replica in (0, 1)] == before
    assert replay.protected == (0, 0)
