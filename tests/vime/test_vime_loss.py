"""VIMELoss is the two losses that it runs; its conventions are among those of tests/objectives."""

from __future__ import annotations

import pytest
import torch
from dynamics_losses import COPIES, dynamics_loss, result, vime_loss
from q_transitions import ACTIONS, FEATURES, bayes_loss, plain_loss, transitions
from torch import nn
from torchrl.data import Categorical
from torchrl.objectives import DiscreteCQLLoss, HardUpdate, SoftUpdate

from bbq_torchrl.networks import q_actor
from bbq_torchrl.objectives import DropoutDQNLoss
from bbq_torchrl.vime import VIMELoss


def linear():
    net = nn.Linear(FEATURES, ACTIONS)
    return q_actor(net, Categorical(ACTIONS), action_mask_key=None)


@pytest.mark.parametrize("replicas", [(), (3,)])
@pytest.mark.parametrize("q", [lambda r: plain_loss(r, dropout=0.5), bayes_loss])
def test_it_returns_what_both_return_and_the_sum(q, replicas):
    loss, td = VIMELoss(q(replicas)[0], dynamics_loss(replicas)), transitions(replicas)
    torch.manual_seed(0)
    parts = loss.q_loss(td.clone()), loss.dynamics_loss(td.clone())
    out = result(loss, td)
    torch.testing.assert_close(out.pop("loss"), sum(part.pop("loss") for part in parts))
    expected = parts[0].update(parts[1])
    assert set(out.keys()) == set(expected.keys())
    assert (out == expected).all()


def test_torchrls_target_updaters_find_the_q_losss_targets():
    q_loss, td = DropoutDQNLoss(linear()), transitions()
    loss = VIMELoss(q_loss, dynamics_loss())
    with pytest.warns(UserWarning, match="No target network updater"):
        loss(td)
    update = HardUpdate(loss, value_network_update_interval=0)
    loss(td)  # warns no more
    with torch.no_grad():
        for parameter in q_loss.parameters():
            parameter.add_(1.0)
    own, targets = q_loss.value_network_params, q_loss.target_value_network_params
    assert not (own == targets).any()
    update.step()
    assert (own == targets).all()
    SoftUpdate(vime_loss()[0], tau=0.5).step()


def test_the_rest_is_the_q_losss():
    loss = VIMELoss(bayes_loss((2,), cache=True)[0], dynamics_loss((2,)))
    assert loss.value_network is loss.q_loss.value_network
    assert loss.replicas == (2,)
    with pytest.raises(AttributeError, match="nothing_of_this_name"):
        _ = loss.nothing_of_this_name
    loss.set_num_data(torch.tensor([3, 4]))
    assert loss.q_loss.num_data.tolist() == loss.dynamics_loss.num_data.tolist() == [3, 4]
    td = transitions((2,))
    first = loss(td)["kl"]
    loss.q_loss.reset_parameters_recursive()
    assert torch.equal(loss(td)["kl"], first)
    loss.begin_epoch()
    assert not torch.equal(loss(td)["kl"], first)


def test_the_dynamics_may_learn_on_every_kth_batch_only():
    loss, _ = vime_loss((2,), dynamics_every=3)
    learned, reported = [], []
    for number in range(8):
        if number == 7:
            loss.begin_epoch()
        loss.zero_grad()
        out = loss(transitions((2,)))
        out["loss"].backward()
        learned.append(loss.dynamics_loss.dynamics.network.posterior.mu.grad is not None)
        reported.append(out["dynamics_loss"])
        assert all(p.grad is not None for p in loss.q_loss.parameters())
    assert learned == [True, False, False, True, False, False, True, True]
    for number, is_new in enumerate(learned[1:], 1):
        assert torch.equal(reported[number], reported[number - 1]) == (not is_new)


@pytest.mark.parametrize("way", COPIES)
def test_it_goes_on_where_it_was(way):
    loss, other = (vime_loss((2,), dynamics_every=3)[0] for _ in range(2))
    batches = [transitions((2,)) for _ in range(5)]
    for td in batches[:2]:
        result(loss, td)
    other = COPIES[way](loss, other)
    for td in batches[2:]:
        assert (result(loss, td) == result(other, td)).all()


def test_bad_parts_and_keys_are_named():
    with pytest.raises(ValueError, match="dynamics_every must be at least 1, got 0"):
        vime_loss(dynamics_every=0)
    part = dynamics_loss()
    with pytest.raises(ValueError, match="must not have parameters in common"):
        VIMELoss(part, part)
    with pytest.raises(ValueError, match="rewards is not an accepted tensordict key"):
        vime_loss()[0].set_keys(rewards="x")
    loss = VIMELoss(DiscreteCQLLoss(linear()), dynamics_loss())
    HardUpdate(loss, value_network_update_interval=0)
    with pytest.raises(KeyError, match=r'key "loss" not found in TensorDict with keys .*loss_cql'):
        loss(transitions())
