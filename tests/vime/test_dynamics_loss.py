"""DynamicsLoss against its definition: value, gradient, the rows that count, keys."""

from __future__ import annotations

import pytest
import torch
from dynamics_losses import dynamics_loss, gradients, model, result
from q_transitions import ACTIONS, REPLICAS, transitions
from torch.distributions import Normal, kl_divergence
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import LossModule

from bbq_torchrl.vime import DynamicsLoss


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("padded", [False, True])
def test_value_and_gradient_are_those_of_the_definition(drawn_noise, replicas, padded):
    dynamics = model(replicas, torch.double, noise_std=0.7, prior_std=0.3)
    loss = DynamicsLoss(dynamics, kl_temperature=0.4)
    count = torch.Size(replicas).numel()
    num_data = torch.arange(10.0, 10.0 + count).double().reshape(replicas)
    loss.set_num_data(num_data)
    td = transitions(replicas, dtype=torch.double)
    counts = torch.ones(td.shape, dtype=torch.bool)
    if padded:
        counts = td["valid"] = torch.rand(*replicas, 32) < 0.7
    out = loss(td)
    posterior = dynamics.network.posterior
    q = Normal(posterior.mu, torch.nn.functional.softplus(posterior.rho))
    weights = q.loc + q.scale * drawn_noise[0].reshape(q.loc.shape)
    mean, std = dynamics.mean.unsqueeze(-2), dynamics.var.sqrt().unsqueeze(-2)
    z, following = ((t["observation"] - mean) / std for t in (td, td["next"]))
    one_hot = torch.nn.functional.one_hot(td["action"], ACTIONS).double()
    predicted = dynamics.network(torch.cat([z, one_hot], -1), weights=weights)
    # the constant of the density is left out
    greatest = Normal(0.0, 0.7).log_prob(torch.zeros(1).double())
    rows = (greatest - Normal(predicted, 0.7).log_prob(following)).sum(-1)
    rows = rows * ~td["next", "terminated"].squeeze(-1) * counts
    kl = kl_divergence(q, Normal(0.0, 0.3)).sum(-1)
    expected = rows.sum(-1) / counts.sum(-1) + 0.4 * kl / num_data
    torch.testing.assert_close(out["loss"], expected.sum())
    torch.testing.assert_close(out["dynamics_loss"], expected.detach())
    torch.testing.assert_close(out["dynamics_kl"], kl.detach())
    parameters = list(loss.parameters())
    torch.testing.assert_close(
        torch.autograd.grad(out["loss"], parameters),
        torch.autograd.grad(expected.sum(), parameters),
    )


def test_rows_that_do_not_count_and_ends_may_hold_anything():
    loss = dynamics_loss((2,))
    td = transitions((2,))
    td["valid"] = torch.rand(2, 32) < 0.6
    expected = gradients(loss, td)
    out = td.clone()
    out["observation"][~td["valid"]] = torch.nan
    out["action"][~td["valid"]] = 999
    ends = td["next", "terminated"].squeeze(-1)
    out["next", "observation"][~td["valid"] | ends] = torch.nan
    assert all(map(torch.equal, gradients(loss, out), expected))


def test_an_element_without_rows_has_the_gradient_of_the_kl_alone():
    loss = dynamics_loss((2,))
    td = transitions((2,))
    td["valid"] = torch.tensor([[True] * 32, [False] * 32])
    out = result(loss, td)
    torch.testing.assert_close(out["dynamics_loss"][1], out["dynamics_kl"][1] / 100)
    assert all(gradient.isfinite().all() for gradient in gradients(loss, td))


def test_a_batch_without_rows_has_the_kl_alone():
    out = result(dynamics_loss(), transitions(batch=(0,)))
    torch.testing.assert_close(out["dynamics_loss"], out["dynamics_kl"] / 100)


def test_a_draw_a_batch_whatever_the_exploration_type(drawn_noise):
    loss = dynamics_loss()
    for exploration in ExplorationType:
        drawn_noise.clear()
        with set_exploration_type(exploration):
            loss(transitions())["loss"].backward()
        assert len(drawn_noise) == 1
    assert loss.dynamics.network.posterior.rho.grad.any()


def test_batches_of_any_shape():
    loss = dynamics_loss((2,))
    td = transitions((2,), (4, 3))
    torch.testing.assert_close(result(loss, td.flatten(1, 2))["loss"], result(loss, td)["loss"])


def test_keys_can_be_set():
    loss = dynamics_loss()
    td = transitions()
    expected = result(loss, td)["loss"]
    td["deep", "state"] = td.pop("observation")
    td["next", "deep", "state"] = td["next"].pop("observation")
    td["next", "over"] = td["next"].pop("terminated")
    td["act"] = td.pop("action")
    loss.set_keys(observation=("deep", "state"), action="act", terminated="over")
    assert loss.in_keys == [("deep", "state"), "act", ("next", "deep", "state"), ("next", "over")]
    assert torch.equal(result(loss, td)["loss"], expected)
    with pytest.raises(ValueError, match="not an accepted tensordict key"):
        loss.set_keys(reward="x")
    loss.set_keys(action=None)
    assert loss.tensor_keys.action == "action"


def test_the_mask_may_have_another_name_and_must_fit():
    loss = dynamics_loss()
    td = transitions()
    td["valid"] = torch.rand(32) < 0.5
    expected = result(loss, td)["loss"]
    td["counts"] = td["valid"].unsqueeze(-1)
    loss.loss_mask_key = "counts"
    assert torch.equal(result(loss, td)["loss"], expected)
    td["counts"] = torch.ones(32, 2).bool()
    with pytest.raises(ValueError, match=r"'counts' must have the batch's shape \[32\]"):
        loss(td)


@pytest.mark.parametrize("key", ["observation", ("next", "terminated")])
def test_a_missing_entry_is_named(key):
    name = key if isinstance(key, str) else key[-1]
    with pytest.raises(KeyError, match=f'key "{name}" not found'):
        dynamics_loss()(transitions().exclude(key))


def test_ends_and_masks_may_be_numbers():
    loss = dynamics_loss()
    td = transitions()
    td["valid"] = torch.rand(32) < 0.5
    expected = result(loss, td)["loss"]
    for key in ("valid", ("next", "terminated")):
        td[key] = td[key].to(torch.uint8)
    assert torch.equal(result(loss, td)["loss"], expected)


def test_it_can_be_called_with_tensors():
    loss = dynamics_loss()
    td = transitions()
    torch.manual_seed(0)
    out = loss(**dict(td.select(*loss.in_keys).flatten_keys("_").items()))
    torch.testing.assert_close(out[0], result(loss, td)["loss"])


def test_what_is_missing_or_no_setting_is_refused():
    with pytest.raises(RuntimeError, match="num_data is not known: give it to DynamicsLoss"):
        dynamics_loss(num_data=None)(transitions())
    with pytest.raises(ValueError, match="kl_temperature must be at least 0 and finite, got -1"):
        dynamics_loss(kl_temperature=-1)


def test_parameters_are_the_models():
    loss = dynamics_loss((2,))
    assert isinstance(loss, LossModule)
    assert {id(p) for p in loss.parameters()} == {id(p) for p in loss.dynamics.parameters()}
    mu = loss.dynamics.network.posterior.mu
    before = mu.clone()
    loss.reset_parameters_recursive()
    assert not torch.equal(mu, before)
    assert loss.dynamics.mean.any()  # the statistics stay
    loss.double()
    assert result(loss, transitions((2,), dtype=torch.double))["loss"].dtype == torch.double
