"""BBQNLoss against its definition, written with torch.distributions and autograd."""

import pytest
import torch
from q_transitions import (
    ACTIONS,
    FEATURES,
    REPLICAS,
    assert_learns,
    bayes_loss,
    flat,
    one_step_target,
    transitions,
)
from torch import nn
from torch.distributions import Normal, kl_divergence
from torch.nn.functional import softplus
from torchrl.data import Categorical
from torchrl.objectives import HardUpdate

from bbq_torchrl.bayes import BayesLinear, BayesMLP
from bbq_torchrl.networks import q_actor
from bbq_torchrl.objectives import BBQNLoss

TARGETS = [("map", "mean"), ("mc", "independent"), ("mc", "shared")]


def definition(loss, td, noises, *, target_noise, kl, noise_std, temperature, gamma, num_data, **_):
    """Returns each replica's loss and KL by the formula, for the drawn noise."""
    net = loss.value_network[0].module
    mu, rho = flat(loss, "mu"), flat(loss, "rho")
    online_noise, *others = (noise.reshape(mu.shape) for noise in noises)
    q, prior = Normal(mu, softplus(rho)), Normal(0.0, net.posterior.prior_std)
    weights = q.loc + q.scale * online_noise
    frozen = flat(loss, "mu", target=True)
    if target_noise != "mean":
        epsilon = online_noise if target_noise == "shared" else others[0]
        frozen = frozen + softplus(flat(loss, "rho", target=True)) * epsilon
    y = one_step_target(td, net(td["next", "observation"], weights=frozen), gamma)
    chosen = net(td["observation"], weights=weights).gather(-1, td["action"].unsqueeze(-1))
    likelihood, greatest = Normal(chosen, noise_std), Normal(0.0, noise_std)
    # the constant of the density is left out
    data = greatest.log_prob(torch.zeros_like(y)) - likelihood.log_prob(y.detach())
    divergence = kl_divergence(q, prior)
    if kl == "sampled":
        divergence = q.log_prob(weights) - prior.log_prob(weights)
    return data.mean((-2, -1)) + temperature * divergence.sum(-1) / num_data, divergence.sum(-1)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize(("target", "target_noise"), TARGETS)
@pytest.mark.parametrize("kl", ["closed", "sampled"])
def test_value_and_gradient_are_those_of_the_definition(
    drawn_noise, replicas, target, target_noise, kl
):
    count = torch.Size(replicas).numel()
    settings = {"target": target, "target_noise": target_noise, "kl": kl}
    settings.update(noise_std=0.7, gamma=0.8)
    loss, _ = bayes_loss(replicas, dtype=torch.double, kl_temperature=0.3, **settings)
    num_data = torch.arange(10.0, 10.0 + count).double().reshape(replicas)
    loss.set_num_data(num_data)
    td = transitions(replicas, dtype=torch.double)
    out = loss(td)
    assert len(drawn_noise) == (2 if target_noise == "independent" else 1)
    expected, expected_kl = definition(
        loss, td, drawn_noise, temperature=0.3, num_data=num_data, **settings
    )
    torch.testing.assert_close(out["loss_value"], expected.detach())
    torch.testing.assert_close(out["kl"], expected_kl.detach())
    assert_learns(loss, out, expected)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [({}, "mean"), ({"target": "map"}, "mean"), ({"target": "mc"}, "independent")],
)
def test_the_target_decides_where_its_noise_comes_from_unless_that_is_said(settings, expected):
    assert bayes_loss(**settings)[0].target_noise == expected
    assert bayes_loss(target_noise=expected, **settings)[0].target_noise == expected


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("kl", ["closed", "sampled"])
def test_a_shared_target_has_the_online_draw_in_all_layers(replicas, kl):
    layers = [
        BayesLinear(*sizes, replicas=replicas, prior_std=0.5, std_init=0.5)
        for sizes in ((FEATURES, 8), (8, 8), (8, ACTIONS))
    ]
    net = nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.ReLU(), layers[2])
    actor = q_actor(net, Categorical(ACTIONS))
    # the value of the action taken, on both sides of the equation
    td = transitions(replicas, ends=0.0)
    td["next"].update(td.select("observation", "action_mask"))
    td["next", "action_mask"] = nn.functional.one_hot(td["action"], ACTIONS).bool()
    td["next", "reward"].zero_()
    for noise in ("shared", "independent"):
        settings = {"target": "mc", "target_noise": noise, "kl": kl, "gamma": 1.0}
        loss = BBQNLoss(actor, num_data=100, **settings)
        HardUpdate(loss, value_network_update_interval=0)
        first, second = loss(td), loss(td)
        assert (first["q_value"] != second["q_value"]).all()  # a draw for each batch
        for out in (first, second):
            assert ((out["td_error"] == 0) == (noise == "shared")).all()


@pytest.mark.parametrize("name", ["noise_std", "kl_temperature", "gamma"])
def test_values_of_replicas_are_where_the_network_is_and_no_part_of_the_state(name):
    net = BayesMLP(FEATURES, ACTIONS, (8,), replicas=3, device="meta")  # fails beside a CPU tensor
    settings = {name: torch.tensor([0.1, 0.2, 0.3]), "delay_value": False}
    loss = BBQNLoss(q_actor(net, Categorical(ACTIONS)), num_data=10, **settings)
    loss(transitions((3,)).to("meta"))["loss"].backward()
    assert net.posterior.mu.grad.device.type == "meta"
    assert name == "gamma" or name in dict(loss.named_buffers())  # which move with their module
    assert name not in loss.state_dict()


def test_num_data_is_set_for_all_or_for_each_replica_and_part_of_the_state():
    loss, other = (bayes_loss((3,), num_data=None)[0] for _ in range(2))
    for given, expected in [(torch.tensor([10, 20, 40]), [10, 20, 40]), (7, [7, 7, 7])]:
        loss.set_num_data(given)
        assert loss.num_data.tolist() == expected
    other.load_state_dict(loss.state_dict())
    assert other(transitions((3,)))["loss"].isfinite()
