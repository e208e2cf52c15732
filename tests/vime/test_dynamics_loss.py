"""DynamicsLoss against its definition: value, gradient, the rows that count, keys."""

from __future__ import annotations

import pytest
import torch
from dynamics_losses import dynamics_loss, gradients, model, result
from q_transitions import ACTIONS, FEATURES, REPLICAS, elements, transitions
from torch.distributions import Normal, kl_divergence
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import LossModule

from bbq_torchrl.vime import DynamicsLoss


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("padded", [False, True])
def test_value_and_gradient_are_those_of_the_definition(drawn_noise, replicas, padded):
    dynamics = model(replicas, torch.double, noise_std=0.7, prior_std=0.3)
    loss = DynamicsLoss(dynamics, kl_temperature=0.4)
    num_data = torch.arange(10.0, 10.0 + torch.Size(replicas).numel()).double()
    loss.set_num_data(num_data.reshape(replicas))
    td = transitions(replicas, dtype=torch.double)
    if padded:
        td["valid"] = torch.rand(*replicas, 32) < 0.7
    out = loss(td)
    posterior = dynamics.network.posterior
    mu, rho = (t.reshape(-1, t.shape[-1]) for t in (posterior.mu, posterior.rho))
    mean, std = (t.reshape(-1, FEATURES) for t in (dynamics.mean, dynamics.var.sqrt()))
    losses, kls = [], []
    for k, batch in enumerate(elements(td, replicas)):
        q = Normal(mu[k], torch.nn.functional.softplus(rho[k]))
        (w1, b1), (w2, b2) = dynamics.network.layout.unflatten(q.loc + q.scale * drawn_noise[0][k])
        z, following = (
            (t - mean[k]) / std[k] for t in (batch["observation"], batch["next", "observation"])
        )
        one_hot = torch.nn.functional.one_hot(batch["action"], ACTIONS).double()
        predicted = (torch.cat([z, one_hot], -1) @ w1 + b1).relu() @ w2 + b2
        # the constant of the density is left out
        rows = -Normal(predicted, 0.7).log_prob(following) + Normal(0.0, 0.7).log_prob(
            torch.zeros(1).double()
        )
        rows = rows.sum(-1) * ~batch["next", "terminated"].squeeze(-1)
        if padded:
            rows = rows[batch["valid"]]
        kls.append(kl_divergence(q, Normal(0.0, 0.3)).sum())
        losses.append(rows.mean() + 0.4 * kls[-1] / num_data[k])
    expected = torch.stack(losses)
    torch.testing.assert_close(out["loss"], expected.sum())
    torch.testing.assert_close(out["dynamics_loss"], expected.detach().reshape(replicas))
    torch.testing.assert_close(out["dynamics_kl"], torch.stack(kls).detach().reshape(replicas))
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


def test_a_draw_a_batch_whatever_the_exploration_type(drawn_noise):
    loss = dynamics_loss()
    for exploration in ExplorationType:
        drawn_noise.clear()
        with set_exploration_type(exploration):
            loss(transitions())["loss"].backward()
        assert len(drawn_noise) == 1
    assert loss.dynamics.network.posterior.rho.grad.any()


def test_one_hot_actions_and_batches_of_any_shape():
    loss = dynamics_loss((2,))
    td = transitions((2,), (4, 3))
    expected = result(loss, td)["loss"]
    flat = td.flatten(1, 2)
    torch.testing.assert_close(result(loss, flat)["loss"], expected)
    flat["action"] = torch.nn.functional.one_hot(flat["action"], ACTIONS)
    torch.testing.assert_close(result(loss, flat)["loss"], expected)


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


def test_it_can_be_called_with_tensors():
    loss = dynamics_loss()
    td = transitions()
    torch.manual_seed(0)
    out = loss(**dict(td.select(*loss.in_keys).flatten_keys("_").items()))
    torch.testing.assert_close(out[0], result(loss, td)["loss"])


def test_what_is_missing_or_no_setting_is_refused():
    with pytest.raises(RuntimeError, match="num_data is not known: give it to DynamicsLoss"):
        dynamics_loss(num_data=None)(transitions())
    with pytest.raises(ValueError, match="kl_temperature must not be negative, got -1"):
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
