"""VIMEReward: the bonus of what is stored, what is read from replay buffers, and refusals."""

from statistics import median_low

import pytest
import q_transitions
import torch
from q_transitions import ACTIONS, FEATURES
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from bbq_torchrl.vime import DynamicsModel, VIMEReward, information_gain

BONUS, REWARD = ("next", "intrinsic_reward"), ("next", "reward")


def transitions(*batch, size=FEATURES, ends=0.2):
    """Random transitions of any batch."""
    return q_transitions.transitions((), batch, features=size, ends=ends)


def transform(replicas=(), size=FEATURES, **settings):
    """A transform whose model starts from the same weights each time."""
    torch.manual_seed(1)
    dynamics = DynamicsModel(size, ACTIONS, (16,), replicas=replicas)
    torch.seed()
    return VIMEReward(dynamics, **settings)


def buffer(transform, size=1000, batch=32):
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(size), transform=transform, batch_size=batch
    )


def going_on(td):
    return ~td["next", "terminated"].squeeze(-1)


def gain_of(vime, td, **settings):
    states = (td["observation"], td["action"], td["next", "observation"])
    return information_gain(vime.dynamics, *states, **settings)


def test_the_bonus_is_the_gain_over_the_median_clipped_and_0_at_an_end():
    vime = transform(clip=2.0, median_window=3)
    medians = []
    for rows, ends in ((40, 0.2), (30, 0.2), (5, 1.1), (20, 0.2), (10, 0.2), (11, 0.2)):
        td = transitions(rows, ends=ends)
        td["next", "observation"][0] = 9.0  # surprises
        td["next", "terminated"][:2] = torch.tensor([[ends > 1], [True]])
        td["next", "observation"][~going_on(td)] = torch.nan
        stored = vime.inv(td)
        gain = gain_of(vime, td)
        if ends < 1:  # a store of ends alone has no median
            medians.append(median_low(gain[going_on(td)].tolist()))
            assert stored[BONUS][0] == 2.0
        expected = (gain / median_low(medians[-3:])).clamp(max=2.0).where(going_on(td), 0.0)
        torch.testing.assert_close(stored[BONUS].squeeze(-1), expected)
        assert torch.equal(stored[REWARD], td[REWARD])
        assert BONUS not in td.keys(True)  # what is stored is a copy


def test_what_is_stored_is_counted_once_in_statistics_and_report():
    vime = transform()
    td = torch.cat([vime.inv(transitions(rows)) for rows in (300, 50)])  # more than one piece
    again = vime.inv(td)  # they come with a bonus: kept, and not counted
    assert torch.equal(again[BONUS], td[BONUS])
    vime(td)
    states = torch.cat([td["observation"], td["next", "observation"][going_on(td)]])
    assert vime.dynamics.count == len(states)
    torch.testing.assert_close(vime.dynamics.mean, states.mean(0), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(vime.dynamics.var, states.var(0, False), rtol=1e-4, atol=1e-5)
    expected = {"intrinsic_reward": td[BONUS].mean()}
    torch.testing.assert_close(vime.pop_metrics(), expected, check_dtype=False)
    assert vime.pop_metrics()["intrinsic_reward"].isnan()


@pytest.mark.parametrize("weights", ["map", "mc"])
def test_mc_is_one_draw_a_store_and_map_none(weights):
    td = transitions(30, ends=0.0)
    vime = transform(weights=weights, clip=1e9, step_size=0.5)
    torch.manual_seed(5)
    bonus = vime.inv(td)[BONUS].squeeze(-1)
    torch.manual_seed(5)
    noise = torch.randn_like(vime.dynamics.network.posterior.mu) if weights == "mc" else None
    gain = gain_of(vime, td, noise=noise, step_size=0.5)
    torch.testing.assert_close(bonus, gain / gain.median())


def test_single_rows_batches_of_any_shape_and_ends_of_any_dtype():
    td = transitions(12)
    expected = transform().inv(td)[BONUS]
    assert torch.equal(transform().inv(td.reshape(3, 4))[BONUS], expected.reshape(3, 4, 1))
    assert transform().inv(td[0])[BONUS].shape == (1,)
    assert transform().inv(td[:0])[BONUS].shape == (0, 1)
    td["next", "terminated"] = td["next", "terminated"].to(torch.uint8)
    assert torch.equal(transform().inv(td)[BONUS], expected)


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


def test_replicas_may_have_an_eta_each_which_follows_the_rows_to_their_device():
    eta, td = torch.tensor([0.1, 0.2, 0.3]), transitions(3, 6)
    vime = transform((3,), eta=eta)
    assert "eta" not in vime.state_dict()
    td[BONUS] = torch.ones(3, 6, 1)
    torch.testing.assert_close(vime(td)[REWARD], td[REWARD] + eta.reshape(3, 1, 1))
    assert vime(td.to("meta"))[REWARD].device.type == "meta"


def test_what_does_not_fit_is_refused():
    for settings in ({"weights": "mean"}, {"eta": -1.0}, {"step_size": 0.0}, {"clip": 0.0}):
        with pytest.raises(ValueError, match=next(iter(settings))):
            transform(**settings)
    with pytest.raises(ValueError, match="replicas"):
        transform((2,)).inv(transitions(3, 8))
    with pytest.raises(ValueError, match="seeds"):
        transform((2,)).set_seeds([3])
