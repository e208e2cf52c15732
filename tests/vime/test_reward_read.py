"""VIMEReward in replay buffers: what is read, what is left as it is, and what is refused."""

from __future__ import annotations

import pytest
import torch
from rewarded import BONUS, REWARD, buffer, transform, transitions


def test_the_bonus_is_added_to_the_reward_that_is_read_and_to_no_stored_one():
    memory, other, td = buffer(transform(eta=0.3)), buffer(transform(eta=0.3)), transitions(100)
    memory.extend(td)
    stored = memory.storage[:].clone()
    assert torch.equal(stored[REWARD], td[REWARD])
    expected = stored[REWARD] + 0.3 * stored[BONUS]
    for _ in range(2):
        batch = memory.sample()
        torch.testing.assert_close(batch[REWARD], expected[batch["index"]])
        torch.testing.assert_close(memory[:][REWARD], expected)
    assert (memory.storage[:] == stored).all()
    other.extend(memory.storage[:])  # how a buffer is copied
    assert torch.equal(other[:][REWARD], memory[:][REWARD])


def test_what_is_read_is_not_changed_and_may_be_a_view():
    vime = transform(eta=1.0)
    rows = vime.inv(transitions(3, 8))
    before = rows.clone()
    assert torch.equal(vime(rows)[REWARD][:, :4], vime(rows[:, :4])[REWARD])
    assert (rows == before).all()


def test_replicas_may_have_an_eta_each_which_follows_the_rows_to_their_device():
    eta, td = torch.tensor([0.1, 0.2, 0.3]), transitions(3, 6)
    vime = transform((3,), eta=eta)
    assert "eta" not in vime.state_dict()
    td[BONUS] = torch.ones(3, 6, 1)
    torch.testing.assert_close(vime(td)[REWARD], td[REWARD] + eta.reshape(3, 1, 1))
    assert vime(td.to("meta"))[REWARD].device.type == "meta"


def test_keys_can_have_other_names():
    plain, td = transform(), transitions(20)
    stored = plain.inv(td)
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
    out = vime.inv(td)
    assert torch.equal(out["next", "agent", "bonus"], stored[BONUS])
    assert torch.equal(vime(out)["next", "pay"], plain(stored)[REWARD])


def test_what_does_not_fit_is_refused():
    for settings in ({"weights": "mean"}, {"eta": -1.0}, {"step_size": 0.0}, {"clip": 0.0}):
        with pytest.raises(ValueError, match=next(iter(settings))):
            transform(**settings)
    with pytest.raises(ValueError, match="replicas"):
        transform((2,)).inv(transitions(3, 8))
    with pytest.raises(ValueError, match="seeds"):
        transform((2,)).set_seeds([3])
