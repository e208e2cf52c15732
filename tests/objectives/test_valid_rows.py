"""The rows of a batch that a loss learns from, their dtypes, and independent replicas."""

import pytest
import torch
from q_transitions import gradients, result, transitions


def everything(loss, td):
    """The outputs of a loss for each replica, and its gradients."""
    return [*result(loss, td).exclude("loss").values(), *gradients(loss, td)]


@pytest.mark.parametrize("entry", ["observation", ("next", "observation"), ("next", "reward")])
def test_rows_that_do_not_count_change_nothing_whatever_they_hold(make, entry):
    loss = make((2,), dtype=torch.double)
    td = transitions((2,), (6,), dtype=torch.double)
    td["valid"] = torch.arange(6).expand(2, 6) < 4
    short = everything(loss, td[:, :4].exclude("valid"))
    torch.testing.assert_close(everything(loss, td), short)
    spoilt = td.clone()
    spoilt[entry][:, 4:] = torch.nan
    assert all(map(torch.equal, everything(loss, spoilt), everything(loss, td)))
    assert torch.equal(spoilt["td_error"], td["td_error"])
    assert not td["td_error"][:, 4:].any()


def test_torchrls_masks_count_together_with_valid_unless_one_is_named(make):
    loss, td = make(dtype=torch.double), transitions(batch=(6,), dtype=torch.double)
    four, middle = result(loss, td[:4])["loss"], result(loss, td[1:4])["loss"]
    mask = torch.arange(6) < 4
    td["collector", "mask"] = mask.unsqueeze(-1)  # as split_trajectories writes it
    torch.testing.assert_close(result(loss, td)["loss"], four)
    td["valid"] = torch.arange(6) > 0
    torch.testing.assert_close(result(loss, td)["loss"], middle)
    td["mine"] = mask.to(torch.uint8)
    loss.loss_mask_key = "mine"
    assert loss.loss_mask_key == "mine"
    torch.testing.assert_close(result(loss, td.exclude("collector"))["loss"], four)
    loss.loss_mask_key = None
    assert not torch.allclose(result(loss, td)["loss"], four)


def test_a_mask_and_priority_weights_multiply(make):
    loss, td = make(dtype=torch.double), transitions(dtype=torch.double)
    td["priority_weight"] = torch.rand(32).double().where(torch.arange(32) > 3, 0.0)
    expected = everything(loss, td[4:16])
    td["valid"] = torch.arange(32) < 16
    torch.testing.assert_close(everything(loss, td), expected)


def test_rewards_may_be_whole_numbers_and_ends_and_masks_too(make):
    loss, td = make(), transitions()
    td["valid"] = torch.rand(32) < 0.6
    td["next", "reward"] = td["next", "reward"].round()
    expected = result(loss, td)["loss"]
    td["next", "reward"] = td["next", "reward"].long()
    for key in ("valid", ("next", "terminated")):
        td[key] = td[key].to(torch.uint8)
    assert torch.equal(result(loss, td)["loss"], expected)


def data_shares(loss, td):
    """The outputs for a batch for each replica, and the gradients."""
    out, outside = result(loss, td), {"loss", "kl"}
    return [out[key] for key in set(out.keys()) - outside] + [*gradients(loss, td)]


def test_a_replica_without_rows_has_no_loss_and_no_gradient(make):
    loss, td = make((2,), data_only=True), transitions((2,))
    td["valid"] = torch.tensor([[False] * 32, [True] * 32])
    for share in data_shares(loss, td):
        assert not share[0].any()
        assert share[1].any()


@pytest.mark.parametrize("replicas", [(), (2,)], ids=str)
def test_a_batch_without_rows_has_no_loss_and_no_gradient(make, replicas):
    loss, td = make(replicas, data_only=True), transitions(replicas, (0,))
    assert not any(share.any() for share in data_shares(loss, td))
    assert td["td_error"].shape == (*replicas, 0, 1)


@pytest.mark.parametrize("entry", ["observation", ("next", "observation")])
def test_what_one_replica_sees_leaves_the_others_bits_alone(make, entry):
    loss, td = make((3,), hidden=(33, 17)), transitions((3,))
    plain = everything(loss, td)
    td[entry][1] = torch.nan
    spoilt = everything(loss, td)
    for ours, theirs in zip(plain, spoilt, strict=True):
        assert torch.equal(ours[[0, 2]], theirs[[0, 2]])
    assert spoilt[-1][1].isnan().any()
