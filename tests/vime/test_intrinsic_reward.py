"""VIMEReward in replay buffers: what is read, what is left as it is, and what is refused."""

from __future__ import annotations

import pytest
import torch
from rewarded import BONUS, REWARD, buffer, transform, transitions
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.custom import PendulumEnv


def test_reading_adds_the_bonus_to_the_reward_that_is_read():
    vime = transform(eta=0.3)
    memory = buffer(vime)
    td = transitions(100)
    memory.extend(td)
    stored = memory._storage.get(slice(0, 100)).clone()
    assert torch.equal(stored[REWARD], td[REWARD])
    for _ in range(3):
        batch = memory.sample()
        index = batch["index"]
        expected = stored[REWARD][index] + 0.3 * stored[BONUS][index]
        torch.testing.assert_close(batch[REWARD], expected)
        whole = memory[:]
        torch.testing.assert_close(whole[REWARD], stored[REWARD] + 0.3 * stored[BONUS])
    assert torch.equal(memory._storage.get(slice(0, 100))[REWARD], td[REWARD])


def test_a_reward_may_lack_the_last_dimension():
    vime = transform(eta=0.3)
    rows = vime.inv(transitions(8))
    expected = vime(rows)[REWARD]
    rows[REWARD] = rows[REWARD].squeeze(-1)
    assert torch.equal(vime(rows)[REWARD], expected.squeeze(-1))


def test_a_buffer_is_copied_from_its_storage():
    memory, other = buffer(transform(eta=0.3)), buffer(transform(eta=0.3))
    memory.extend(transitions(100))
    other.extend(memory.storage[:])
    assert torch.equal(other[:][REWARD], memory[:][REWARD])


def test_what_is_read_is_not_changed():
    vime = transform(eta=1.0)
    rows = vime.inv(transitions(3, 8))
    before = rows.clone()
    once, twice = vime(rows), vime(rows)
    assert torch.equal(once[REWARD], twice[REWARD])
    assert not torch.equal(once[REWARD], before[REWARD])
    assert (rows == before).all()
    view = rows[:, :4]  # of memory that is used again
    vime(view)
    assert (rows == before).all()


def test_an_eta_of_each_replica_follows_the_rows_to_their_device():
    td = transitions(3, 6).to("meta")
    td[BONUS] = torch.ones(3, 6, 1, device="meta")
    assert transform((3,), eta=torch.ones(3))(td)[REWARD].device.type == "meta"


def test_an_eta_of_each_replica_is_no_part_of_the_state_and_must_fit():
    assert "eta" not in transform((3,), eta=torch.ones(3)).state_dict()
    with pytest.raises(
        ValueError, match=r"eta must be one number or have the replicas' shape \[3\]"
    ):
        transform((3,), eta=torch.ones(2))


def test_keys_can_have_other_names():
    td = transitions(20)
    expected = transform()
    stored = expected.inv(td)
    td = td.clone()
    td["agent", "state"] = td.pop("observation")
    td["next", "agent", "state"] = td["next"].pop("observation")
    td["act"] = td.pop("action")
    td["next", "pay"] = td["next"].pop("reward")
    td["next", "over"] = td["next"].pop("terminated")
    vime = transform(
        observation_key=("agent", "state"),
        action_key="act",
        reward_key="pay",
        terminated_key="over",
        intrinsic_reward_key=("agent", "bonus"),
    )
    assert vime.out_keys_inv == [("next", "agent", "bonus")]
    out = vime.inv(td)
    assert torch.equal(out["next", "agent", "bonus"], stored[BONUS])
    assert torch.equal(vime(out)["next", "pay"], expected(stored)[REWARD])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"weights": "mean"}, r"weights must be one of \['map', 'mc'\], got 'mean'"),
        ({"eta": -1.0}, "eta must be at least 0 and finite, got -1.0"),
        ({"step_size": 0.0}, "step_size must be positive, got 0.0"),
        ({"clip": 0.0}, "clip must be positive, got 0.0"),
        ({"median_window": 0}, "median_window must be at least 1, got 0"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(ValueError, match=message):
        transform(**settings)


def test_it_refuses_environments_and_other_replicas():
    with pytest.raises(ValueError, match="transform of replay buffers"):
        TransformedEnv(PendulumEnv(), transform())
    with pytest.raises(ValueError, match="transform of replay buffers"):
        TransformedEnv(PendulumEnv(), Compose(transform()))
    with pytest.raises(ValueError, match=r"must begin with the replicas \[2\], got \[3, 8\]"):
        transform((2,)).inv(transitions(3, 8))
    bad = transitions(3)
    bad["observation"][1] = torch.nan
    vime = transform()
    with pytest.raises(ValueError, match="must be finite in the rows that count, but 1 of 3 rows"):
        vime.inv(bad)
    assert vime.dynamics.mean.isfinite().all()
    bad["valid"] = torch.tensor([True, False, True])
    assert vime.inv(bad)[BONUS].isfinite().all()
    with pytest.raises(KeyError, match="stored without this transform"):
        transform()(transitions(5))
