"""DropoutDQNLoss against TorchRL's DQNLoss and its definition."""

from __future__ import annotations

from contextlib import contextmanager
from copy import deepcopy

import pytest
import torch
from q_transitions import (
    ACTIONS,
    FEATURES,
    REPLICAS,
    elements,
    flat,
    plain_loss,
    transitions,
)
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Categorical
from torchrl.modules import QValueModule
from torchrl.objectives import DQNLoss, HardUpdate

from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import DropoutDQNLoss


def torchrl_loss_like(ours, element=0, **settings):
    """TorchRL's own loss on a copy of an element's network and of its frozen copy."""
    net = FlatMLP(FEATURES, ACTIONS, (8, 8), dtype=flat(ours, "weight").dtype)
    theirs = DQNLoss(
        q_actor(net, Categorical(ACTIONS)), delay_value=True, reduction="mean", **settings
    )
    theirs.make_value_estimator(gamma=0.9)
    HardUpdate(theirs, value_network_update_interval=0)
    for target in (False, True):
        weights = flat(ours, "weight", target=target).data.reshape(-1, net.layout.numel)
        flat(theirs, "weight", target=target).data.copy_(weights[element])
    return theirs


@contextmanager
def to_module(loss):
    """Other parameters within it, as TensorDicts swap them."""
    with TensorDict.from_module(loss).apply(lambda p: p + 1).to_module(loss):
        yield


@contextmanager
def to_targets(loss):
    """Other parameters of the frozen copy within it."""
    target = loss.target_value_network_params.data.apply(lambda p: p + 1)
    with TensorDict(target_value_network_params=target).to_module(loss):
        yield


@contextmanager
def to_parameters(loss):
    """Other data in the parameters, as torch's own function writes them."""
    vector = nn.utils.parameters_to_vector(loss.parameters())
    nn.utils.vector_to_parameters(vector + 1, loss.parameters())
    yield
    nn.utils.vector_to_parameters(vector, loss.parameters())


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("double_dqn", [False, True])
@pytest.mark.parametrize("loss_function", ["l2", "l1", "smooth_l1"])
@pytest.mark.parametrize("batch", [(32,), (4, 8)])
def test_each_replica_has_torchrls_loss(replicas, double_dqn, loss_function, batch):
    settings = {"double_dqn": double_dqn, "loss_function": loss_function}
    ours, _ = plain_loss(replicas, dtype=torch.double, **settings)
    td = transitions(replicas, batch, dtype=torch.double)
    out = ours(td)
    (gradient,) = torch.autograd.grad(out["loss"], flat(ours, "weight"))
    torch.testing.assert_close(out["loss"], out["loss_value"].sum())
    count = torch.Size(replicas).numel()
    values = {key: out[key].reshape(count) for key in ("loss_value", "td_error", "q_value")}
    errors = td["td_error"].reshape(count, *batch, 1)
    for k, rows in enumerate(elements(td.exclude("td_error"), replicas)):
        theirs = torchrl_loss_like(ours, k, **settings)
        expected = theirs(rows)
        torch.testing.assert_close(values["loss_value"][k], expected["loss"].detach())
        torch.testing.assert_close(errors[k], rows["td_error"])
        torch.testing.assert_close(values["td_error"][k], rows["td_error"].sqrt().mean())
        (own,) = torch.autograd.grad(expected["loss"], flat(theirs, "weight"))
        torch.testing.assert_close(gradient.reshape(count, -1)[k], own)
        q = theirs.value_network(rows.select("observation", "action_mask"))["action_value"].detach()
        chosen = q.gather(-1, rows["action"].unsqueeze(-1))
        torch.testing.assert_close(values["q_value"][k], chosen.mean())


@pytest.mark.parametrize("weighted", [True, False])
def test_prioritized_replay_weights_are_torchrls(weighted):
    ours, _ = plain_loss(dtype=torch.double)
    theirs = torchrl_loss_like(ours)
    ours.use_prioritized_weights = theirs.use_prioritized_weights = weighted or "auto"
    td = transitions(dtype=torch.double)
    td["priority_weight"] = torch.rand(32, dtype=torch.double)
    torch.testing.assert_close(ours(td)["loss"], theirs(td)["loss"])
    ours.use_prioritized_weights = False
    assert not torch.allclose(ours(td)["loss"], theirs(td)["loss"])


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("kind", ["flat", "torch"])
def test_dropout_is_on_in_the_prediction_and_off_in_the_targets(kind, training):
    net = FlatMLP(FEATURES, ACTIONS, (32,), dropout=0.5)
    if kind == "torch":
        layers = nn.Linear(FEATURES, 32), nn.ReLU(), nn.Dropout(0.5), nn.Linear(32, ACTIONS)
        net = nn.Sequential(*layers)
    loss = DropoutDQNLoss(q_actor(net, Categorical(ACTIONS)), double_dqn=True)
    HardUpdate(loss, value_network_update_interval=0)
    td = transitions()
    net.train(training)  # what acting does to the network must not matter
    targets = [loss._td_target(td, *loss._tensors()) for _ in range(2)]
    assert torch.equal(*targets)
    assert loss(td)["loss"] != loss(td)["loss"]
    assert all(module.training == training for module in net.modules())


def test_a_mask_of_another_shape_is_refused():
    loss, _ = plain_loss((2,))
    td = transitions((2,), (2,))
    td["rows"] = torch.ones(2, 2, 3, dtype=torch.bool)
    loss.loss_mask_key = "rows"
    with pytest.raises(
        ValueError, match=r"'rows' must have the batch's shape \[2, 2\], got \[2, 2, 3\]"
    ):
        loss(td)


def test_torchrls_padding_masks_are_honored_too():
    loss, _ = plain_loss()
    td = transitions(batch=(6,))
    expected = loss(td[:4])["loss"]
    mask = torch.tensor([True] * 4 + [False] * 2)
    td["collector", "mask"] = mask.unsqueeze(-1)  # as split_trajectories writes it
    torch.testing.assert_close(loss(td)["loss"], expected)
    td["valid"] = torch.tensor([False] + [True] * 5)
    torch.testing.assert_close(loss(td)["loss"], loss(td[1:4])["loss"])
    td["mine"] = mask
    loss.loss_mask_key = "mine"
    torch.testing.assert_close(loss(td.exclude("collector"))["loss"], expected)
    loss.loss_mask_key = None
    assert not torch.allclose(loss(td)["loss"], expected)


def test_a_terminal_state_needs_no_legal_action():
    loss, _ = plain_loss()
    td = transitions()
    td["next", "terminated"][:] = True
    expected = loss(td)["loss"]
    td["next", "action_mask"][:] = False
    assert torch.equal(loss(td)["loss"], expected)


def test_settings_outside_of_what_is_listed_are_refused():
    with pytest.raises(
        ValueError, match=r"loss_function must be one of \['l2', 'l1', 'smooth_l1'\]"
    ):
        plain_loss(loss_function="huber")
    with pytest.raises(ValueError, match="double_dqn=True requires delay_value=True"):
        plain_loss(double_dqn=True, delay_value=False)
    with pytest.raises(ValueError, match="action_space must be categorical or one-hot, got binary"):
        DropoutDQNLoss(q_actor(FlatMLP(5, 4), Categorical(4)), action_space="binary")
    mixed = nn.Sequential(FlatMLP(5, 4, replicas=(2,)), FlatMLP(4, 4, replicas=(3,)))
    with pytest.raises(ValueError, match="must have one replica dimension in common"):
        DropoutDQNLoss(q_actor(mixed, Categorical(4)))


def test_without_a_frozen_copy_the_target_follows_the_network():
    loss = DropoutDQNLoss(q_actor(FlatMLP(5, ACTIONS), Categorical(ACTIONS)), delay_value=False)
    td = transitions()
    before = loss._td_target(td, *loss._tensors())
    with torch.no_grad():
        flat(loss, "weight").mul_(2.0)
    assert not torch.equal(loss._td_target(td, *loss._tensors()), before)
    loss(td)["loss"].backward()


@pytest.mark.parametrize(
    ("delay_value", "replace"),
    [
        *((False, way) for way in (to_module, to_parameters)),
        *((True, way) for way in (to_module, to_targets, to_parameters)),
    ],
)
def test_parameters_put_in_the_place_of_others_are_used(delay_value, replace):
    actor = q_actor(FlatMLP(FEATURES, ACTIONS, (8,)), Categorical(ACTIONS))
    settings = {"delay_value": delay_value}
    ours, theirs = DropoutDQNLoss(actor, **settings), DQNLoss(deepcopy(actor), **settings)
    theirs.make_value_estimator(gamma=0.9)
    if delay_value:
        for loss in (ours, theirs):
            HardUpdate(loss, value_network_update_interval=1)
    td = transitions()
    torch.testing.assert_close(ours(td)["loss"], theirs(td)["loss"])
    values = []
    for loss in (ours, theirs):
        with replace(loss):
            values.append(loss(td)["loss"])
    torch.testing.assert_close(*values)
    torch.testing.assert_close(ours(td)["loss"], theirs(td)["loss"])


@pytest.mark.parametrize("kind", [nn.LSTM, nn.GRU])
def test_dropout_within_a_recurrent_layer_is_set_too(kind):
    layers = kind(FEATURES, 16, num_layers=2, dropout=0.5)
    trunk = TensorDictModule(layers, ["observation"], ["hidden", "_"])
    head = TensorDictModule(nn.Linear(16, ACTIONS), ["hidden"], ["action_value"])
    choice = QValueModule(action_space="categorical", action_mask_key="action_mask")
    loss = DropoutDQNLoss(TensorDictSequential(trunk, head, choice), action_space="categorical")
    HardUpdate(loss, value_network_update_interval=0)
    td = transitions()
    loss.eval()
    assert torch.equal(loss.next_state_values(td), loss.next_state_values(td))
    assert loss(td)["loss"] != loss(td)["loss"]
