"""DropoutDQNLoss against TorchRL's DQNLoss and its definition."""

from __future__ import annotations

import pytest
import torch
from q_transitions import (
    ACTIONS,
    FEATURES,
    REPLICAS,
    elements,
    flat,
    network,
    plain_loss,
    slopes,
    target_of,
    transitions,
)
from torch import nn
from torchrl.data import Categorical
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss, HardUpdate

from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import DropoutDQNLoss


def torchrl_loss_like(ours, **settings):
    """TorchRL's own loss on a copy of the network and of its frozen copy."""
    net = FlatMLP(FEATURES, ACTIONS, (8, 8), dtype=flat(ours, "weight").dtype)
    theirs = DQNLoss(
        q_actor(net, Categorical(ACTIONS)), delay_value=True, reduction="mean", **settings
    )
    theirs.make_value_estimator(gamma=0.9)
    HardUpdate(theirs, value_network_update_interval=0)
    flat(theirs, "weight").data.copy_(flat(ours, "weight").data)
    flat(theirs, "weight", target=True).data.copy_(flat(ours, "weight", target=True).data)
    return theirs


@pytest.mark.parametrize("double_dqn", [False, True])
@pytest.mark.parametrize("loss_function", ["l2", "l1", "smooth_l1"])
@pytest.mark.parametrize("batch", [(32,), (4, 8)])
def test_without_dropout_it_is_torchrls_loss(double_dqn, loss_function, batch):
    settings = {"double_dqn": double_dqn, "loss_function": loss_function}
    ours, _ = plain_loss(dtype=torch.double, **settings)
    theirs = torchrl_loss_like(ours, **settings)
    td = transitions(batch=batch, dtype=torch.double)
    expected_td = td.clone()
    out, expected = ours(td), theirs(expected_td)
    torch.testing.assert_close(out["loss"], expected["loss"])
    torch.testing.assert_close(td["td_error"], expected_td["td_error"])
    torch.testing.assert_close(
        torch.autograd.grad(out["loss"], flat(ours, "weight")),
        torch.autograd.grad(expected["loss"], flat(theirs, "weight")),
    )


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


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("double_dqn", [False, True])
def test_each_replica_is_a_network_of_its_own(replicas, double_dqn):
    loss, _ = plain_loss(replicas, dtype=torch.double, double_dqn=double_dqn, gamma=0.8)
    td = transitions(replicas, dtype=torch.double)
    out = loss(td)
    layout = loss.value_network[0].module.layout
    rows = lambda t: t.reshape(-1, layout.numel)  # noqa: E731
    expected, errors, values = [], [], []
    for weights, frozen, batch in zip(
        rows(flat(loss, "weight")),
        rows(flat(loss, "weight", target=True)),
        elements(td, replicas),
        strict=True,
    ):
        y = target_of(layout, frozen, batch, 0.8)
        if double_dqn:
            q = network(layout, weights, batch["next", "observation"])
            best = q.masked_fill(~batch["next", "action_mask"], -torch.inf).argmax(-1, True)
            q = network(layout, frozen, batch["next", "observation"]).gather(-1, best).squeeze(-1)
            going_on = ~batch["next", "terminated"].squeeze(-1)
            y = (batch["next", "reward"].squeeze(-1) + 0.8 * going_on * q).detach()
        chosen = network(layout, weights, batch["observation"])
        chosen = chosen.gather(-1, batch["action"].unsqueeze(-1)).squeeze(-1)
        expected.append((chosen - y).square().mean())
        errors.append((chosen - y).abs().mean().detach())
        values.append(chosen.mean().detach())
    expected = torch.stack(expected).reshape(replicas)
    torch.testing.assert_close(out["loss_value"], expected.detach())
    torch.testing.assert_close(out["loss"], expected.sum())
    torch.testing.assert_close(out["td_error"], torch.stack(errors).reshape(replicas))
    torch.testing.assert_close(out["q_value"], torch.stack(values).reshape(replicas))
    torch.testing.assert_close(
        torch.autograd.grad(out["loss"], flat(loss, "weight")),
        torch.autograd.grad(expected.sum(), flat(loss, "weight")),
    )


@pytest.mark.parametrize("training", [True, False])
def test_dropout_is_on_in_the_prediction_and_off_in_the_targets(training):
    loss, _ = plain_loss(dropout=0.5, double_dqn=True)
    td = transitions()
    loss.value_network.train(training)  # what acting does to the network must not matter
    targets = [loss._td_target(td["next"], *loss._tensors()) for _ in range(2)]
    assert torch.equal(*targets)
    assert loss(td)["loss"] != loss(td)["loss"]
    assert loss.value_network[0].module.training == training


def test_torch_dropout_layers_are_on_in_the_prediction_only_too():
    net = nn.Sequential(nn.Linear(FEATURES, 32), nn.ReLU(), nn.Dropout(0.5), nn.Linear(32, ACTIONS))
    loss = DropoutDQNLoss(QValueActor(net, spec=Categorical(ACTIONS)))
    HardUpdate(loss, value_network_update_interval=0)
    td = transitions()
    for training in (True, False):
        net.train(training)
        targets = [loss._td_target(td["next"], *loss._tensors()) for _ in range(2)]
        assert torch.equal(*targets)
        assert loss(td)["loss"] != loss(td)["loss"]
        assert net[2].training == training


def test_the_gradient_is_that_of_the_network_with_the_dropped_units():
    loss, _ = plain_loss(dropout=0.5, hidden=(64,), dtype=torch.double)
    td = transitions(dtype=torch.double)
    torch.testing.assert_close(*slopes(loss, td), rtol=1e-5, atol=0)


def test_rows_that_do_not_count_change_nothing_whatever_they_hold():
    loss, _ = plain_loss((2,), dtype=torch.double)
    td = transitions((2,), (6,), dtype=torch.double)
    td["valid"] = torch.tensor([[True] * 4 + [False] * 2, [True] * 6])
    spoilt = td.clone()
    spoilt["next", "reward"][0, 4:] = float("nan")
    spoilt["observation"][0, 4:] = 1e6
    results = []
    for batch in (td, spoilt):
        out = loss(batch)
        results.append((out["loss_value"], *torch.autograd.grad(out["loss"], flat(loss, "weight"))))
    torch.testing.assert_close(*results)
    short = plain_loss(dtype=torch.double)[0]
    flat(short, "weight").data.copy_(flat(loss, "weight").data[0])
    flat(short, "weight", target=True).copy_(flat(loss, "weight", target=True)[0])
    expected = short(td[0, :4].exclude("valid"))
    torch.testing.assert_close(results[0][0][0], expected["loss_value"])
    out = loss(td)
    for key in ("td_error", "q_value"):
        torch.testing.assert_close(out[key][0], expected[key])


def test_an_element_without_rows_has_no_loss_and_no_gradient():
    loss, _ = plain_loss((2,))
    td = transitions((2,))
    td["valid"] = torch.tensor([[False] * 32, [True] * 32])
    out = loss(td)
    out["loss"].backward()
    assert out["loss_value"][0] == 0
    assert not flat(loss, "weight").grad[0].any()
    assert flat(loss, "weight").grad[1].any()


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
    td["collector", "mask"] = mask.unsqueeze(-1)
    loss.loss_mask_key = "auto"
    torch.testing.assert_close(loss(td)["loss"], expected)
    td["mine"] = mask
    loss.loss_mask_key = "mine"
    torch.testing.assert_close(loss(td.exclude("collector"))["loss"], expected)
    loss.loss_mask_key = None
    assert not torch.allclose(loss(td)["loss"], expected)


@pytest.mark.parametrize("where", ["next", "root"])
def test_what_one_element_sees_leaves_the_others_gradient_bits_alone(where):
    def gradient(spoil):
        torch.manual_seed(0)
        loss, _ = plain_loss((3,), dropout=0.5, hidden=(33,))
        td = transitions((3,))
        if spoil:
            (td if where == "root" else td["next"])["observation"][1] = float("nan")
        torch.manual_seed(1)
        loss(td)["loss"].backward()
        return flat(loss, "weight").grad

    plain, spoilt = gradient(False), gradient(True)
    assert torch.equal(plain[[0, 2]], spoilt[[0, 2]])
    assert spoilt[1].isnan().any()


def test_a_terminal_state_needs_no_legal_action():
    loss, _ = plain_loss()
    td = transitions()
    td["next", "terminated"][:] = True
    expected = loss(td)["loss"]
    td["next", "action_mask"][:] = False
    assert torch.equal(loss(td)["loss"], expected)


def test_one_hot_actions_are_understood():
    loss, _ = plain_loss()
    other = DropoutDQNLoss(loss.value_network, action_space="one-hot")
    HardUpdate(other, value_network_update_interval=0)
    flat(other, "weight", target=True).copy_(flat(loss, "weight", target=True))
    td = transitions()
    expected = loss(td)["loss"]
    td["action"] = nn.functional.one_hot(td["action"], ACTIONS)
    torch.testing.assert_close(other(td)["loss"], expected)


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
    before = loss._td_target(td["next"], *loss._tensors())
    with torch.no_grad():
        flat(loss, "weight").mul_(2.0)
    assert not torch.equal(loss._td_target(td["next"], *loss._tensors()), before)
    loss(td)["loss"].backward()
