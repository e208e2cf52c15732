"""The count bonus against a plain dictionary of counts."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import TransformedEnv

from bbq_torchrl.data import CountReward, ReplicaReplay
from bbq_torchrl.envs import DialogueEnv

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain

KEYS = [("next", "observation"), ("next", "reward")]


def _rows(states: torch.Tensor) -> TensorDict:
    batch = states.shape[:-1]
    following = {"observation": states, "reward": torch.full((*batch, 1), 2.0)}
    return TensorDict({"next": following}, batch)


def test_bonus_is_one_over_the_root_of_a_dictionarys_counts() -> None:
    generator = torch.Generator().manual_seed(0)
    transform, counts = CountReward(4, eta=0.5), Counter[tuple[bool, ...]]()
    stored = []
    for _ in range(3):
        states = torch.randint(0, 2, (50, 4), generator=generator).float()
        counts.update(tuple(row) for row in (states > 0).tolist())
        stored.append((states, transform.inv(_rows(states))))
    for states, rows in stored:
        wanted = [2 + 0.5 * counts[tuple(row)] ** -0.5 for row in (states > 0).tolist()]
        read = transform(rows)["next", "reward"].squeeze(-1)
        torch.testing.assert_close(read, torch.tensor(wanted))
        assert (rows["next", "reward"] == 2).all()  # what is stored stays the task's


def test_only_the_counted_features_tell_states_apart() -> None:
    transform = CountReward(torch.tensor([True, False]))
    states = torch.tensor([[1.0, 0.0], [5.0, 1.0], [0.0, 1.0]])
    read = transform(transform.inv(_rows(states)))["next", "reward"].squeeze(-1)
    torch.testing.assert_close(read, torch.tensor([2 + 0.5**0.5, 2 + 0.5**0.5, 3.0]))


def test_replicas_count_for_themselves_and_leave_out_what_is_not_valid() -> None:
    transform = CountReward(1, eta=torch.tensor([1.0, 2.0]), replicas=(2,))
    rows = _rows(torch.ones(2, 4, 1))
    rows["valid"] = torch.tensor([[True] * 4, [True, False, False, False]])
    read = transform(transform.inv(rows))["next", "reward"].squeeze(-1)
    assert read[0].tolist() == [2.5] * 4
    assert read[1, 0].item() == 4.0
    assert transform.pop_metrics()["intrinsic_reward"].tolist() == [0.5, 1.0]


def test_counts_are_part_of_a_replays_state() -> None:
    replay = ReplicaReplay(8, keys=KEYS, transform=CountReward(2, replicas=(1,)))
    replay.extend([_rows(torch.ones(4, 2))])
    other = ReplicaReplay(8, keys=KEYS, transform=CountReward(2, replicas=(1,)))
    other.load_state_dict(replay.state_dict())
    for each in (replay, other):
        (batch,) = each.epoch(4)
        assert batch.transitions["next", "reward"].unique().tolist() == [2.5]


def test_a_torchrl_buffer_takes_it() -> None:
    memory = TensorDictReplayBuffer(
        storage=LazyTensorStorage(10), transform=CountReward(2), batch_size=4
    )
    memory.extend(_rows(torch.ones(9, 2)))
    torch.testing.assert_close(memory.sample()["next", "reward"], torch.full((4, 1), 2 + 1 / 3))


def test_what_was_stored_without_it_is_refused() -> None:
    with pytest.raises(KeyError, match="stored without this transform"):
        CountReward(2)(_rows(torch.ones(4, 2)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"features": torch.zeros(3, dtype=torch.bool)}, "features must include at least one"),
        ({"features": 3, "buckets": 0}, "buckets must be an integer from 1"),
        ({"features": 3, "eta": -1.0}, "eta must be"),
    ],
)
def test_arguments_are_checked(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CountReward(**arguments)  # type: ignore[arg-type]


def test_environments_are_refused(movie: Domain) -> None:
    with pytest.raises(ValueError, match="not of an environment"):
        TransformedEnv(DialogueEnv(movie), CountReward(2))
