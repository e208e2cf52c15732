"""BootstrapDQNLoss against a loop over heads in plain torch."""

import pytest
import torch
from q_transitions import (
    HEADS,
    REPLICAS,
    assert_learns,
    elements,
    flat,
    heads_loss,
    one_step_target,
    transitions,
)
from torch.func import functional_call
from torchrl.objectives import SoftUpdate


def heads_apart(loss, td, gamma=0.9, double_dqn=False):
    """The TD errors of each replica's heads, in the rows that they learn from, and their Q."""
    net = loss.value_network[0].module

    def values(td, *, target):
        tensors = {name: flat(loss, name, target=target) for name in net.state_dict()}
        return elements(functional_call(net, tensors, (td["observation"],)), net.replicas)

    batches, online = elements(td, net.replicas), values(td, target=False)
    frozen, choice = (values(td["next"], target=target) for target in (True, False))
    for k, batch in enumerate(batches):
        for head in range(HEADS):
            own = choice[k][..., head, :] if double_dqn else None
            y = one_step_target(batch, frozen[k][..., head, :], gamma, choice=own).detach()
            chosen = online[k][..., head, :].gather(-1, batch["action"].unsqueeze(-1))
            learns = batch["bootstrap_mask"][..., head]
            yield (chosen - y)[learns], chosen[learns], learns


def with_mask(td, share=0.5):
    """The batch with masks in which every head learns from the last row."""
    mask = torch.rand(*td.shape, HEADS) < share
    mask[..., -1, :] = True
    return td.set("bootstrap_mask", mask)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize(("batch", "share"), [((32,), 1.0), ((4, 8), 0.5)])
@pytest.mark.parametrize("trunk_layers", [0, 1, 2])
@pytest.mark.parametrize("double_dqn", [False, True])
def test_it_is_a_loop_over_heads(replicas, batch, share, trunk_layers, double_dqn):
    settings = {"double_dqn": double_dqn, "gamma": 0.8}
    layers = {"trunk_layers": trunk_layers, "prior_scale": 0.5}
    loss, _ = heads_loss(replicas, dtype=torch.double, **layers, **settings)
    td = with_mask(transitions(replicas, batch, dtype=torch.double), share)
    apart = [*heads_apart(loss, td, **settings)]
    td = td.clone()
    if share < 1:  # a row that no head learns from may hold anything
        td["observation"][~td["bootstrap_mask"].any(-1)] = torch.nan
        loss.set_keys(bootstrap_mask=("my", "mask"))
        td.rename_key_("bootstrap_mask", ("my", "mask"))
    else:
        del td["bootstrap_mask"]
    out = loss(td)

    def by_head(values):
        return torch.stack([*values]).reshape(-1, HEADS)

    losses = by_head(error.square().mean() for error, *_ in apart)
    sizes = by_head(error.abs().mean() for error, *_ in apart)
    q_values = by_head(chosen.mean() for _, chosen, _ in apart)
    assert_learns(loss, out, losses)
    means = {"loss_value": losses, "td_error": sizes, "q_value": q_values}
    for key, value in means.items():
        torch.testing.assert_close(out[key], value.mean(-1).reshape(replicas).detach())
    squares = torch.zeros(len(apart) // HEADS, HEADS, *batch, dtype=torch.double)
    learns = torch.stack([rows for *_, rows in apart]).reshape(squares.shape)
    squares[learns] = torch.cat([error.detach() for error, *_ in apart]).square().squeeze(-1)
    expected = squares.sum(1) / learns.sum(1).clamp_min(1)
    torch.testing.assert_close(td["td_error"], expected.reshape(*td.shape, 1))


def test_a_head_without_rows_is_left_out_of_the_means():
    loss, _ = heads_loss(dtype=torch.double)
    td = transitions(batch=(8,), dtype=torch.double)
    td["bootstrap_mask"] = torch.tensor([True, True, False]).expand(8, HEADS)
    out = loss(td)
    first, second, _ = (q.mean() for _, q, _ in heads_apart(loss, td))
    torch.testing.assert_close(out["q_value"], ((first + second) / 2).detach())
    assert not torch.autograd.grad(out["loss"], flat(loss, "heads"))[0][2].any()


def test_every_head_has_a_frozen_copy_with_the_same_prior():
    loss, update = heads_loss((2,), prior_scale=1.0)
    priors = {name: flat(loss, name).clone() for name in ("prior_trunk", "prior_heads")}
    soft = SoftUpdate(loss, tau=0.5)
    optimizer = torch.optim.SGD(loss.parameters(), 0.1, weight_decay=0.1)
    for _ in range(3):
        optimizer.zero_grad()
        loss(with_mask(transitions((2,))))["loss"].backward()
        optimizer.step()
        soft.step()
        update.step()
    loss.reset_parameters_recursive()
    for name, prior in priors.items():
        for target in (False, True):
            assert torch.equal(flat(loss, name, target=target), prior)
