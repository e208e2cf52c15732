"""DropoutDQNLoss against TorchRL's DQNLoss, NoisyDQNLoss and the TD loss by definition."""

import pytest
import torch
from q_transitions import (
    ACTIONS,
    FEATURES,
    REPLICAS,
    assert_learns,
    away,
    elements,
    flat,
    noisy_loss,
    one_step_target,
    plain_loss,
    transitions,
)
from torch import nn
from torch.func import functional_call, grad
from torchrl.data import Categorical
from torchrl.objectives import DQNLoss, HardUpdate

from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import DropoutDQNLoss, NoisyDQNLoss
from bbq_torchrl.objectives.td_loss import td_loss


def torchrl_loss_like(ours, element=0, **settings):
    """TorchRL's loss on a copy of one replica's network and of its frozen copy."""
    net = FlatMLP(FEATURES, ACTIONS, (8, 8), dtype=torch.double)
    theirs = DQNLoss(q_actor(net, Categorical(ACTIONS)), delay_value=True, **settings)
    theirs.make_value_estimator(gamma=0.9)
    HardUpdate(theirs, value_network_update_interval=0)
    for target in (False, True):
        weights = flat(ours, "weight", target=target).data.reshape(-1, net.layout.numel)
        flat(theirs, "weight", target=target).data.copy_(weights[element])
    return theirs


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("double_dqn", [False, True])
@pytest.mark.parametrize("loss_function", ["l2", "l1", "smooth_l1"])
@pytest.mark.parametrize("batch", [(32,), (4, 8)])
def test_each_replica_has_torchrls_loss(replicas, double_dqn, loss_function, batch):
    settings = {"double_dqn": double_dqn, "loss_function": loss_function}
    ours, _ = plain_loss(replicas, dtype=torch.double, **settings)
    td = transitions(replicas, batch, dtype=torch.double)
    batches = elements(td.clone(), replicas)
    out = ours(td)
    (gradient,) = torch.autograd.grad(out["loss"], flat(ours, "weight"))
    torch.testing.assert_close(out["loss"], out["loss_value"].sum())
    errors = elements(td["td_error"], replicas)
    for k, rows in enumerate(batches):
        theirs = torchrl_loss_like(ours, k, **settings)
        loss = theirs(rows)["loss"]
        torch.testing.assert_close(out["loss_value"].flatten()[k], loss.detach())
        torch.testing.assert_close(errors[k], rows["td_error"])
        torch.testing.assert_close(out["td_error"].flatten()[k], rows["td_error"].sqrt().mean())
        (own,) = torch.autograd.grad(loss, flat(theirs, "weight"))
        torch.testing.assert_close(gradient.reshape(len(batches), -1)[k], own)
        q = theirs.value_network(rows.select("observation", "action_mask"))["action_value"].detach()
        chosen = q.gather(-1, rows["action"].unsqueeze(-1))
        torch.testing.assert_close(out["q_value"].flatten()[k], chosen.mean())


@pytest.mark.parametrize("weighted", [True, False, "auto"])
def test_prioritized_replay_weights_are_torchrls(weighted):
    ours, _ = plain_loss(dtype=torch.double)
    theirs = torchrl_loss_like(ours)
    ours.use_prioritized_weights = theirs.use_prioritized_weights = weighted
    td = transitions(dtype=torch.double)
    td["priority_weight"] = torch.rand(32, dtype=torch.double)
    loss, expected = ours(td)["loss"], theirs(td)["loss"]
    torch.testing.assert_close(loss, expected)
    torch.testing.assert_close(
        torch.autograd.grad(loss, flat(ours, "weight")),
        torch.autograd.grad(expected, flat(theirs, "weight")),
    )
    without = theirs(td.exclude("priority_weight"))["loss"]
    assert torch.allclose(ours(td)["loss"], without) == (weighted is False)


def flat_net():
    return q_actor(FlatMLP(FEATURES, ACTIONS, (32,), dropout=0.5), Categorical(ACTIONS))


def torch_net():
    layers = nn.Linear(FEATURES, 32), nn.ReLU(), nn.Dropout(0.5), nn.Linear(32, ACTIONS)
    return q_actor(nn.Sequential(*layers), Categorical(ACTIONS))


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("double_dqn", [False, True])
@pytest.mark.parametrize("network", [flat_net, torch_net])
def test_dropout_is_on_in_the_prediction_and_off_in_the_targets(network, double_dqn, training):
    actor = network()
    actor.train(training)  # what acting does to the network must not matter
    loss, _ = away(DropoutDQNLoss(actor, action_space="categorical", double_dqn=double_dqn))
    td = transitions()
    td["next", "reward"] += 100
    first, second = loss(td), loss(td)
    assert first["q_value"] != second["q_value"]
    # every target is greater than the prediction, so these are the means of the targets
    targets = [out["q_value"] + out["td_error"] for out in (first, second)]
    torch.testing.assert_close(*targets)
    assert all(module.training == training for module in actor.modules())


def test_a_terminal_state_needs_no_legal_action():
    loss, _ = plain_loss()
    td = transitions(ends=1.1)
    expected = loss(td)["loss"]
    td["next", "action_mask"][:] = False
    assert torch.equal(loss(td)["loss"], expected)


# -- noise -------------------------------------------------------------------------------------


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("double_dqn", [False, True])
@pytest.mark.parametrize(("kind", "mode"), [(NoisyDQNLoss, "draw"), (DropoutDQNLoss, "mean")])
def test_noisy_losses_are_those_of_the_definition(replicas, double_dqn, kind, mode):
    settings = {"double_dqn": double_dqn, "gamma": 0.8, "kind": kind, "dtype": torch.double}
    loss, _ = noisy_loss(replicas, hidden=(8, 6), **settings)
    td = transitions(replicas, dtype=torch.double)
    net = loss.value_network[0].module
    own, frozen = (
        dict(params["module", "0", "module"].flatten_keys(".").items())
        for params in (loss.value_network_params, loss.target_value_network_params)
    )
    torch.manual_seed(0)
    out = loss(td)
    torch.manual_seed(0)  # the noises are drawn in this order: online, target, choice
    values = functional_call(net, own, (td["observation"], "draw"))
    target = functional_call(net, frozen, (td["next", "observation"], mode))
    choice = functional_call(net, own, (td["next", "observation"], mode)) if double_dqn else None
    y = one_step_target(td, target, 0.8, choice=choice).detach()
    expected = (y - values.gather(-1, td["action"].unsqueeze(-1))).square().mean((-2, -1))
    torch.testing.assert_close(out["loss_value"], expected.detach())
    assert_learns(loss, out, expected)


def test_gradients_under_a_transform_are_the_hand_written_ones():
    values, index, target = torch.randn(2, 6, 4), torch.randint(4, (2, 6, 1)), torch.randn(2, 6, 1)

    def loss(values, target):
        return td_loss(values, index, target)[0].sum()

    expected = torch.autograd.grad(loss(values.requires_grad_(), target), values)
    by_values, by_target = grad(loss, (0, 1))(values.detach(), target)
    torch.testing.assert_close((by_values,), expected)
    assert not by_target.any()
