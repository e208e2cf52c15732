"""What is computed once for many batches: the frozen network's values, and what BBQN holds."""

from __future__ import annotations

import pickle
from copy import deepcopy

import pytest
import torch
from q_transitions import (
    bayes_loss,
    flat,
    heads_loss,
    noisy_loss,
    plain_loss,
    transitions,
)

from bbq_torchrl.bayes.weight_draw import draw_with_kl
from bbq_torchrl.objectives import DropoutDQNLoss
from bbq_torchrl.vime import DynamicsLoss, DynamicsModel, VIMELoss

FIXED = {"dqn": plain_loss, "bbqn": bayes_loss, "bootstrap": heads_loss}


def gradients(loss, td):
    torch.manual_seed(5)
    out = loss(td)
    return out, torch.autograd.grad(out["loss"], list(loss.parameters()))


# ------------------------------------------------------------------------- frozen values


@pytest.mark.parametrize("name", FIXED)
@pytest.mark.parametrize("replicas", [(), (3,)], ids=str)
def test_a_loss_with_next_state_values_at_hand_is_the_same_loss(name, replicas):
    loss, _ = FIXED[name](replicas, dtype=torch.double)
    td = transitions(replicas, dtype=torch.double)
    expected = gradients(loss, td)
    td["next", "next_state_value"] = loss.next_state_values(td)
    # Nothing of the next state is read any more.
    td["next", "observation"].fill_(torch.nan)

    found = gradients(loss, td)

    for key in ("loss", "loss_value", "td_error"):
        torch.testing.assert_close(found[0][key], expected[0][key])
    torch.testing.assert_close(found[1], expected[1])


def test_next_state_values_follow_the_freeze_and_not_the_network():
    loss, update = plain_loss((2,))
    td = transitions((2,))
    before = loss.next_state_values(td)
    with torch.no_grad():
        for parameter in loss.parameters():
            parameter.add_(0.5)
    assert torch.equal(loss.next_state_values(td), before)
    update.step()
    assert not torch.allclose(loss.next_state_values(td), before)


def test_the_entry_has_the_name_that_set_keys_gives_it():
    loss, _ = plain_loss()
    loss.set_keys(next_state_value="held")
    td = transitions()
    td["next", "held"] = loss.next_state_values(td)
    td["next", "observation"].fill_(torch.nan)
    assert loss(td)["loss"].isfinite()


@pytest.mark.parametrize(
    "loss",
    [
        plain_loss(double_dqn=True),
        bayes_loss(target="mc"),
        bayes_loss(target="mc", target_noise="shared"),
        heads_loss(double_dqn=True),
        noisy_loss(),
    ],
    ids=["double", "mc", "mc shared", "double heads", "noisy"],
)
def test_targets_that_change_from_batch_to_batch_are_not_frozen(loss):
    assert not loss[0].has_fixed_targets
    with pytest.raises(RuntimeError, match="the same for every batch"):
        loss[0].next_state_values(transitions())


def test_targets_of_the_network_that_learns_are_not_frozen():
    loss, _ = plain_loss()
    online = DropoutDQNLoss(loss.value_network, delay_value=False, action_space="categorical")
    assert loss.has_fixed_targets
    assert not online.has_fixed_targets


def test_a_loss_with_vime_has_the_q_losss_next_state_values():
    q_loss, _ = plain_loss()
    loss = VIMELoss(q_loss, DynamicsLoss(DynamicsModel(5, 4)))
    td = transitions()
    assert loss.has_fixed_targets
    assert torch.equal(loss.next_state_values(td), q_loss.next_state_values(td))
    assert not VIMELoss(noisy_loss()[0], loss.dynamics_loss).has_fixed_targets


# ------------------------------------------------------------------------- what BBQN holds


@pytest.mark.parametrize("replicas", [(), (3,)], ids=str)
@pytest.mark.parametrize("prior", [[0.3], [0.3] * 50], ids=["one prior", "a prior a weight"])
def test_a_known_kl_is_returned_with_todays_gradient(replicas, prior):
    mu = torch.randn(*replicas, 50, dtype=torch.double, requires_grad=True)
    rho = torch.randn(*replicas, 50, dtype=torch.double, requires_grad=True)
    noise, prior = torch.randn(*replicas, 50).double(), torch.tensor(prior).double()
    known = torch.rand(replicas).double()
    factor = torch.randn(*replicas, 50).double()

    def both(known):
        weights, kl = draw_with_kl(mu, rho, prior, "closed", noise, None, known)
        return weights, kl, torch.autograd.grad((weights * factor).sum() + 3 * kl.sum(), (mu, rho))

    weights, kl, slopes = both(None)
    again, value, same_slopes = both(known)
    assert torch.equal(value, known)
    assert not torch.allclose(kl, known)
    assert torch.equal(again, weights)
    torch.testing.assert_close(same_slopes, slopes)


def test_the_kl_is_reported_again_until_the_next_epoch():
    loss, _ = bayes_loss((2,), hold=True)
    td = transitions((2,))

    def move():
        with torch.no_grad():
            loss.value_network.get_submodule("module.0.module").posterior.mu.add_(1.0)

    loss.begin_epoch()
    first = loss(td)["kl"]
    move()
    assert torch.equal(loss(td)["kl"], first)
    loss.begin_epoch()
    assert (loss(td)["kl"] > first).all()


def test_an_mc_target_holds_the_frozen_standard_deviations():
    # With μ⁻ = 0 and σ⁻ all but 0 the target is the reward; with σ⁻ large it is not.
    loss, _ = bayes_loss(hold=True, target="mc", hidden=(), noise_std=1.0)
    td = transitions()
    td["next", "terminated"].zero_()
    rho, mu = flat(loss, "rho", target=True), flat(loss, "mu", target=True)
    with torch.no_grad():
        mu.zero_()
        rho.fill_(-40.0)

    def error():
        with torch.no_grad():
            online = flat(loss, "rho")
            online.fill_(-40.0)
        return loss(td)["td_error"]

    loss.begin_epoch()
    near = error()
    with torch.no_grad():
        rho.fill_(10.0)
    torch.testing.assert_close(error(), near)
    loss.begin_epoch()
    assert error() > near + 1


def test_what_is_held_is_not_copied_or_saved():
    loss, _ = bayes_loss(hold=True, target="mc")
    td = transitions()
    loss.begin_epoch()
    loss(td)
    for other in (deepcopy(loss), pickle.loads(pickle.dumps(loss))):
        assert other(td)["loss"].isfinite()
    assert set(loss.state_dict()) == set(bayes_loss(target="mc")[0].state_dict())


def test_a_mask_and_priority_weights_multiply():
    loss, _ = plain_loss(dtype=torch.double)
    td = transitions(dtype=torch.double)
    td["priority_weight"] = torch.rand(td.shape).double()
    expected = loss(td[:8])["loss"]
    td["valid"] = torch.arange(32) < 8
    torch.testing.assert_close(loss(td)["loss"], expected)
