"""BootstrapDQNLoss against a loop over heads in plain torch."""

from __future__ import annotations

import pytest
import torch
from q_transitions import (
    ACTIONS,
    FEATURES,
    HEADS,
    REPLICAS,
    elements,
    flat,
    heads_loss,
    transitions,
)
from torch import nn
from torch.func import functional_call
from torchrl.data import Categorical, OneHot
from torchrl.objectives import HardUpdate, SoftUpdate

from bbq_torchrl.networks import FlatMLP, bootstrap_actor, q_actor
from bbq_torchrl.objectives import BootstrapDQNLoss


def network_of(loss):
    return loss.value_network[0].module


def weights(loss, *, target=False):
    """Names and tensors of the network's weights, the prior's too."""
    names = [*network_of(loss).state_dict()]
    return {name: flat(loss, name, target=target) for name in names}


def head_loss(loss, td, element, head, gamma=0.9, double=False):
    """One head's loss, mean |TD error|, mean Q and squared errors, apart from all others."""
    net = network_of(loss)
    own, frozen = weights(loss), weights(loss, target=True)

    def values(tensors, state):
        out = functional_call(net, tensors, (state["observation"],))
        return elements(out, net.replicas)[element][:, head]

    batch = elements(td, net.replicas)[element]
    counts = torch.ones(len(batch), dtype=torch.bool)
    if batch.get("bootstrap_mask", None) is not None:
        counts = batch["bootstrap_mask"][:, head]
    target = values(frozen, td["next"])
    choice = values(own, td["next"]) if double else target
    best = choice.masked_fill(~batch["next", "action_mask"], -torch.inf).argmax(-1, keepdim=True)
    y = batch["next", "reward"] + gamma * target.gather(-1, best) * ~batch["next", "terminated"]
    chosen = values(own, td).gather(-1, batch["action"].unsqueeze(-1))
    y, chosen = y[counts].detach(), chosen[counts]
    squares = torch.zeros(len(batch), dtype=chosen.dtype)
    squares[counts] = (chosen - y).detach().square().squeeze(-1)
    return (
        nn.functional.mse_loss(chosen, y),
        (chosen - y).abs().mean().detach(),
        chosen.mean().detach(),
        squares,
    )


def masked(td, share=0.5):
    """The batch with masks in which every head learns from the first row."""
    mask = torch.rand(*td.shape, HEADS) < share
    mask.flatten(0, -2)[:: td.shape[-1]] = True
    return td.set("bootstrap_mask", mask)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("trunk_layers", [0, 1, 2])
@pytest.mark.parametrize("double_dqn", [False, True])
@pytest.mark.parametrize("with_masks", [False, True])
def test_it_is_a_loop_over_heads(replicas, trunk_layers, double_dqn, with_masks):
    loss, _ = heads_loss(
        replicas,
        trunk_layers=trunk_layers,
        prior_scale=0.5,
        double_dqn=double_dqn,
        gamma=0.8,
        dtype=torch.double,
    )
    td = transitions(replicas, dtype=torch.double)
    if with_masks:
        masked(td)
    out = loss(td)
    results = [
        [head_loss(loss, td, e, k, 0.8, double_dqn) for k in range(HEADS)]
        for e in range(torch.Size(replicas).numel())
    ]

    def means(which):
        return torch.stack([torch.stack([r[which] for r in row]).mean() for row in results])

    total = torch.stack([r[0] for row in results for r in row]).sum()
    torch.testing.assert_close(out["loss"], total)
    for which, key in enumerate(["loss_value", "td_error", "q_value"]):
        torch.testing.assert_close(out[key], means(which).detach().reshape(replicas))
    squares = torch.stack([torch.stack([r[3] for r in row]).sum(0) for row in results])
    learning = td["bootstrap_mask"].sum(-1) if with_masks else torch.tensor(HEADS)
    expected = squares.reshape(td.shape) / learning.clamp_min(1)
    torch.testing.assert_close(td["td_error"].squeeze(-1), expected)

    names = [name for name, _ in network_of(loss).named_parameters()]
    ours = torch.autograd.grad(out["loss"], [flat(loss, name) for name in names])
    theirs = torch.autograd.grad(total, [flat(loss, name) for name in names])
    torch.testing.assert_close(ours, theirs)


def test_every_head_has_a_frozen_copy_with_the_same_prior():
    loss, update = heads_loss((2,), prior_scale=1.0)
    net = network_of(loss)
    for name in ("prior_trunk", "prior_heads"):
        assert torch.equal(flat(loss, name), flat(loss, name, target=True))
        assert flat(loss, name).data_ptr() == getattr(net, name).data_ptr()
    priors = {name: flat(loss, name).clone() for name in ("prior_trunk", "prior_heads")}
    soft = SoftUpdate(loss, tau=0.5)
    optimizer = torch.optim.SGD(loss.parameters(), 0.1, weight_decay=0.1)
    for _ in range(3):
        optimizer.zero_grad()
        loss(masked(transitions((2,))))["loss"].backward()
        optimizer.step()
        soft.step()
        update.step()
    loss.reset_parameters_recursive()
    for name, prior in priors.items():
        for target in (False, True):
            assert torch.equal(flat(loss, name, target=target), prior)
    assert not any("prior" in name for name, _ in loss.named_parameters())


def test_prioritized_replay_weights_count():
    loss, _ = heads_loss(dtype=torch.double)
    td = masked(transitions(batch=(8,), dtype=torch.double))
    td["priority_weight"] = torch.tensor([1.0, 0, 1, 0, 1, 1, 0, 1], dtype=torch.double)
    expected = loss(td[td["priority_weight"] > 0].exclude("priority_weight"))["loss"]
    torch.testing.assert_close(loss(td)["loss"], expected)


def test_batches_may_have_more_dimensions():
    loss, _ = heads_loss((2,), dtype=torch.double)
    td = masked(transitions((2,), (4, 8), dtype=torch.double))
    expected = td.reshape(2, 32)
    torch.testing.assert_close(loss(td)["loss"], loss(expected)["loss"])
    torch.testing.assert_close(td["td_error"].reshape(2, 32, 1), expected["td_error"])


def test_the_mask_may_have_another_name():
    loss, _ = heads_loss()
    td = masked(transitions())
    expected = loss(td)["loss"]
    assert loss.tensor_keys.bootstrap_mask == "bootstrap_mask"
    td["my", "mask"] = td.pop("bootstrap_mask")
    assert not torch.equal(loss(td)["loss"], expected)
    loss.set_keys(bootstrap_mask=("my", "mask"))
    assert torch.equal(loss(td)["loss"], expected)
    loss.set_keys(bootstrap_mask=None)
    assert loss.tensor_keys.bootstrap_mask == "bootstrap_mask"


def test_one_hot_actions_are_understood():
    loss, _ = heads_loss()
    actor = bootstrap_actor(network_of(loss), OneHot(ACTIONS))
    other = BootstrapDQNLoss(actor)
    HardUpdate(other, value_network_update_interval=0)
    for name in ("trunk", "heads"):
        flat(other, name, target=True).copy_(flat(loss, name, target=True))
    td = masked(transitions())
    expected = loss(td)["loss"]
    td["action"] = nn.functional.one_hot(td["action"], ACTIONS)
    torch.testing.assert_close(other(td)["loss"], expected)


def test_shapes_that_do_not_fit_are_refused():
    loss, _ = heads_loss((2,))
    td = transitions((2,))
    for shape, allowed in [
        ((2, 32, HEADS + 1), r"\[2, 32, 3\]"),
        ((2, 32, 1), r"\[2, 32, 3\]"),
        ((2, 32), r"\[2, 32, heads\]"),
        ((2, 31, HEADS), r"\[2, 32, heads\]"),
    ]:
        td = transitions((2,))
        td.auto_batch_size_(1)
        td["bootstrap_mask"] = torch.ones(shape, dtype=torch.bool)
        with pytest.raises(ValueError, match=f"'bootstrap_mask' must have shape {allowed}, got"):
            loss(td)
    single = BootstrapDQNLoss(q_actor(FlatMLP(FEATURES, ACTIONS), Categorical(ACTIONS)))
    HardUpdate(single, value_network_update_interval=0)
    with pytest.raises(ValueError, match=r"must return values \[\*batch, heads, actions\] with"):
        single(transitions())
    with pytest.raises(ValueError, match="loss_function must be one of"):
        heads_loss(loss_function="huber")


def test_a_head_without_rows_is_left_out_of_the_means():
    loss, _ = heads_loss(dtype=torch.double)
    td = transitions(batch=(8,), dtype=torch.double)
    td["bootstrap_mask"] = torch.tensor([True, True, False]).expand(8, HEADS)
    out = loss(td)
    expected = torch.stack([head_loss(loss, td, 0, k)[2] for k in range(2)]).mean()
    torch.testing.assert_close(out["q_value"], expected)
    assert not torch.autograd.grad(out["loss"], flat(loss, "heads"))[0][2].any()
