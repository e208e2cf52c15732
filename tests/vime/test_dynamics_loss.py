"""DynamicsLoss against its definition, and its schedule."""

import pytest
import torch
from dynamics_losses import COPIES, dynamics_loss, model, result
from q_transitions import ACTIONS, FEATURES, REPLICAS, assert_learns, transitions
from torch.distributions import Normal, kl_divergence
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.vime import DynamicsLoss


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize(
    ("batch", "share", "weighted", "settings"),
    [
        ((32,), 1.0, False, {}),
        ((4, 8), 0.7, False, {"kl_temperature": 0.4}),
        ((4, 8), 0.7, True, {}),
        ((0,), 1.0, False, {}),
    ],
    ids=["all rows", "some rows", "some rows, weighted", "no rows"],
)
def test_value_and_gradient_are_those_of_the_definition(
    drawn_noise, replicas, batch, share, weighted, settings
):
    dynamics = model(replicas, torch.double, noise_std=0.7, prior_std=0.3)
    loss = DynamicsLoss(dynamics, **settings)
    count = torch.Size(replicas).numel()
    num_data = torch.arange(10.0, 10.0 + count).double().reshape(replicas)
    loss.set_num_data(num_data)
    td = transitions(replicas, batch, dtype=torch.double)
    given, counts = td.clone(), torch.rand(td.shape) < share
    if share < 1:
        counts.view(count, -1)[1:2] = False  # a replica without rows
        given["valid"] = counts
    weight = torch.ones(td.shape, dtype=torch.double)
    if weighted:
        given["priority_weight"] = weight.uniform_()
    weight = weight * counts
    # what does not count, and the state after an end, may be anything
    predicted = counts & ~td["next", "terminated"].squeeze(-1)
    given["observation"][~counts] = torch.nan
    given["action"][~counts] = 999
    given["next", "observation"][~predicted] = torch.nan
    out = loss(given)

    posterior = dynamics.network.posterior
    q = Normal(posterior.mu, torch.nn.functional.softplus(posterior.rho))
    weights = q.loc + q.scale * drawn_noise[0].reshape(q.loc.shape)
    shape = (*replicas, *(1 for _ in batch), FEATURES)
    mean, std = dynamics.mean.reshape(shape), dynamics.var.sqrt().reshape(shape)
    z, following = ((t["observation"] - mean) / std for t in (td, td["next"]))
    one_hot = torch.nn.functional.one_hot(td["action"], ACTIONS).double()
    found = dynamics.network(torch.cat([z, one_hot], -1), weights=weights)
    # the constant of the density is left out
    greatest = Normal(0.0, 0.7).log_prob(torch.zeros(1).double())
    rows = (greatest - Normal(found, 0.7).log_prob(following)).sum(-1) * predicted * weight
    temperature = settings.get("kl_temperature", 1.0)
    number = weight.reshape(*replicas, -1).sum(-1).clamp_min(1e-300)
    kl = kl_divergence(q, Normal(0.0, 0.3)).sum(-1)
    expected = rows.reshape(*replicas, -1).sum(-1) / number + temperature * kl / num_data
    torch.testing.assert_close(out["dynamics_loss"], expected.detach())
    torch.testing.assert_close(out["dynamics_kl"], kl.detach())
    assert_learns(loss, out, expected)


def test_a_draw_a_batch_whatever_the_exploration_type(drawn_noise):
    loss = dynamics_loss()
    for exploration in ExplorationType:
        drawn_noise.clear()
        loss.zero_grad()
        with set_exploration_type(exploration):
            loss(transitions())["loss"].backward()
        assert len(drawn_noise) == 1
        assert loss.dynamics.network.posterior.rho.grad.any()


def test_keys_can_be_set():
    loss, td = dynamics_loss(), transitions()
    expected = result(loss, td)["loss"]
    td["deep", "state"] = td.pop("observation")
    td["next", "deep", "state"] = td["next"].pop("observation")
    loss.set_keys(observation=("deep", "state"))
    assert loss.in_keys == [
        ("deep", "state"),
        "action",
        ("next", "deep", "state"),
        ("next", "terminated"),
    ]
    assert torch.equal(result(loss, td)["loss"], expected)


def test_the_dynamics_learn_every_this_many_batches_and_report_the_last_losses_in_between():
    loss = dynamics_loss((2,), every=3)
    learned, reported = [], []
    for number in range(8):
        if number == 7:
            loss.begin_epoch()
        out = loss(transitions((2,)))
        learned.append(out["loss"].requires_grad)
        assert learned[-1] or out["loss"] == 0
        reported.append(out["dynamics_loss"])
    assert learned == [True, False, False, True, False, False, True, True]
    for number, is_new in enumerate(learned[1:], 1):
        assert torch.equal(reported[number], reported[number - 1]) == (not is_new)


@pytest.mark.parametrize("way", COPIES)
def test_a_copy_continues_the_schedule(way):
    loss, other = (dynamics_loss((2,), every=3) for _ in range(2))
    batches = [transitions((2,)) for _ in range(5)]
    for td in batches[:2]:
        result(loss, td)
    other = COPIES[way](loss, other)
    for td in batches[2:]:
        assert (result(loss, td) == result(other, td)).all()


def test_what_is_missing_or_no_setting_is_refused():
    with pytest.raises(ValueError, match="every"):
        dynamics_loss(every=0)
    with pytest.raises(RuntimeError, match="num_data"):
        dynamics_loss(num_data=None)(transitions())
    with pytest.raises(ValueError, match="kl_temperature"):
        dynamics_loss(kl_temperature=-1)
