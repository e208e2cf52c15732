"""Replay buffers of several replicas: epochs, eviction, spiking, state, transforms."""

from copy import deepcopy
from itertools import pairwise

import pytest
import torch
from hypothesis import given, strategies as st
from tensordict import TensorDict
from torchrl.envs import Compose, RewardScaling, Transform

from bbq_torchrl.data import BootstrapMask, ReplicaReplay

KEYS = ["observation", ("next", "reward")]


def rows(first, count):
    numbers = torch.arange(first, first + count, dtype=torch.float32).unsqueeze(-1)
    return TensorDict(
        {"observation": numbers, "extra": numbers, "next": {"reward": 100 * numbers}}, [count]
    )


def filled(*lengths, capacity=2000, transform=None):
    """A replay whose replica r contains lengths[r] rows, numbered from 10,000 r."""
    replay = ReplicaReplay(capacity, replicas=len(lengths), keys=KEYS, transform=transform)
    replay.extend([rows(10_000 * r, length) for r, length in enumerate(lengths)])
    return replay


def stored(replay, replica):
    return replay.buffers[replica][:]["observation"][:, 0].int().tolist()


def play_epoch(replay, batch_size=4):
    """The numbers each replica sees in an epoch, in order, from 0."""
    seen = [[] for _ in range(replay.replicas)]
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
    st.sampled_from([("protect", None), ("restore", None)]),
)


@given(st.lists(ACTS, max_size=8))
def test_each_replica_keeps_what_is_protected_and_the_newest_of_the_rest(acts):
    """Compared with two lists for each replica, for any sequence of operations."""
    replay, capacity, written = filled(3, 1, capacity=5), 5, 100
    kept, newest = [[], []], [[0, 1, 2], [10_000]]
    for act, argument in acts:
        if act == "extend":
            replay.extend([rows(written, count) for count in argument])
            for r, count in enumerate(argument):
                newest[r] += range(written, written + count)
                newest[r] = newest[r][-(capacity - len(kept[r])) :]
            written += 10
        elif act == "restore":
            state = replay.state_dict()
            replay = filled(1, 4, capacity=capacity)
            replay.load_state_dict(state)
        elif max(replay.lengths) < capacity:
            replay.protect()
            kept, newest = [kept[r] + newest[r] for r in (0, 1)], [[], []]

        assert replay.protected == tuple(map(len, kept))
        for batch in replay.epoch(3):
            for own, seen in zip(kept, batch.transitions.unbind(0), strict=True):
                is_kept = torch.isin(seen["observation"][:, 0], torch.tensor(own))
                marks = seen.get("protected", torch.zeros(3).bool())
                assert torch.equal(marks, is_kept & seen["valid"])
        for r in (0, 1):
            numbers = stored(replay, r)
            assert numbers[: len(kept[r])] == kept[r]
            assert sorted(numbers[len(kept[r]) :]) == sorted(newest[r])


# -- computed entries ----------------------------------------------------------------------

SQUARE = ("next", "square")


def square(transitions):
    return transitions["observation"] ** 2


def read(replay):
    return torch.cat([batch.transitions for batch in replay.epoch(32)], 1)


@pytest.mark.parametrize("lengths", [(7,), (600,), (512, 3), (1, 1025, 513)], ids=str)
def test_an_epoch_hands_out_each_transitions_own(lengths):
    replay = filled(*lengths)
    replay.compute(SQUARE, lambda td: -td["observation"])
    replay.compute(SQUARE, square)  # replaces the earlier values
    replay.compute(("next", "reward"), lambda td: td["next", "reward"] + 1)  # of what is stored
    for _ in range(2):
        transitions = read(replay)
        assert torch.equal(transitions[SQUARE], transitions["observation"] ** 2)
        assert torch.equal(transitions["next", "reward"], 100 * transitions["observation"] + 1)
        assert transitions["valid"].sum(-1).tolist() == list(lengths)
    stored = replay.buffers[0][:]["next", "reward"]
    assert torch.equal(stored, rows(0, lengths[0])["next", "reward"])


@pytest.mark.parametrize(
    "change",
    [
        lambda replay: replay.extend([rows(45, 1)]),
        lambda replay: replay.load_state_dict(deepcopy(replay.state_dict())),
    ],
    ids=["extend", "load"],
)
def test_it_is_gone_once_the_transitions_change(change):
    replay = filled(40)
    replay.protect()
    replay.extend([rows(40, 5)])
    replay.compute(SQUARE, square)
    change(replay)
    assert SQUARE not in read(replay).keys(include_nested=True)


# -- transforms ----------------------------------------------------------------------------


class Measured(Transform):
    def pop_metrics(self):
        return {"novelty": torch.tensor([1.0, 2.0])}


def replay_with_three():
    """A replay of two replicas, with three transforms in a row."""
    doubled = RewardScaling(0.0, 2.0, in_keys=[("next", "reward")])
    three = Compose(BootstrapMask(8, replicas=2), doubled, Measured())
    return ReplicaReplay(2000, replicas=2, keys=KEYS, transform=three)


def masks_of(seed, count):
    mask = BootstrapMask(8)
    mask.set_seeds([seed])
    return mask.inv(TensorDict(batch_size=[count]))["bootstrap_mask"]


def test_every_part_adds_what_is_stored_by_each_replicas_seed_and_changes_what_is_read():
    replay = replay_with_three()
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

    # both go along in a state
    other = replay_with_three()
    other.load_state_dict(replay.state_dict())
    other.extend([rows(6, 3), rows(5, 4)])
    assert torch.equal(other.buffers[0][:]["bootstrap_mask"], masks_of(7, 9))
    assert torch.equal(other.buffers[1][:]["bootstrap_mask"], masks_of(8, 9))


@pytest.mark.parametrize("transforms", [(Measured(), None), (None, Measured())])
def test_a_state_of_another_transform_is_refused(transforms):
    ours, theirs = (filled(1, 1, transform=each) for each in transforms)
    with pytest.raises(ValueError, match="the same transform"):
        ours.load_state_dict(theirs.state_dict())


# -- refusals ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "key"),
    [
        (lambda replay: replay.epoch(0), "batch_size"),
        (lambda replay: replay.extend([rows(0, 1)]), "rows"),
        (
            lambda replay: replay.extend([rows(0, 3), rows(0, 3).exclude("observation")]),
            "observation",
        ),
        (lambda replay: replay.protect(), "capacity"),
        (lambda replay: ReplicaReplay(0), "^capacity "),
        (lambda replay: ReplicaReplay(5).epoch(2), "replica"),
        (lambda replay: ReplicaReplay(5).compute("x", abs), "replica"),
        (lambda replay: replay.load_state_dict(filled(1).state_dict()), "replicas"),
        (lambda replay: replay.load_state_dict(filled(9, 9).state_dict()), "capacity"),
    ],
)
def test_wrong_calls_are_refused_and_change_nothing(wrong, key):
    replay = filled(2, 5, capacity=5)
    before = [stored(replay, replica) for replica in (0, 1)]
    with pytest.raises((ValueError, KeyError), match=key):
        wrong(replay)
    assert [stored(replay, replica) for replica in (0, 1)] == before
    assert replay.protected == (0, 0)
