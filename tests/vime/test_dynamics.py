"""DynamicsModel and DynamicsLoss by their definitions: statistics, predictions, replicas."""

import pytest
import torch
from q_transitions import (
    ACTIONS,
    COPIES,
    FEATURES,
    REPLICAS,
    assert_learns,
    dynamics_loss,
    elements,
    model,
    result,
    transitions,
)
from torch.distributions import Normal, kl_divergence

from bbq_torchrl.vime import DynamicsLoss, DynamicsModel

S, A = FEATURES, ACTIONS


# -- statistics ------------------------------------------------------------------------------


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_statistics_are_those_of_all_rows_that_counted(replicas, dtype):
    dynamics = DynamicsModel(S, A, replicas=replicas, dtype=dtype)
    x = 5 + 2 * torch.randn(*replicas, 38, S, dtype=dtype)
    valid = torch.rand(*replicas, 38) < 0.6
    x[~valid] = torch.nan
    for rows in (slice(0, 1), slice(1, 8), slice(8, 38)):
        dynamics.update_statistics(x[..., rows, :], valid[..., rows])
    found = (elements(t, replicas) for t in (dynamics.mean, dynamics.var, dynamics.count))
    for mean, var, count, own, counts in zip(
        *found, elements(x, replicas), elements(valid, replicas), strict=True
    ):
        rows = own[counts].double()
        assert count == len(rows)
        torch.testing.assert_close(mean.double(), rows.mean(0), rtol=1e-5, atol=1e-6)
        expected = rows.var(0, unbiased=False)
        torch.testing.assert_close(var.double(), expected, rtol=1e-4, atol=1e-5)


def test_statistics_do_not_drift_far_from_the_origin():
    # float32 sums of squares would lose everything here
    dynamics = DynamicsModel(1, 1)
    x = 3000 + 0.5 * torch.randn(4000, 1)
    for piece in x.split(100):
        dynamics.update_statistics(piece)
    assert dynamics.mean.item() == pytest.approx(x.double().mean().item(), rel=1e-6)
    assert dynamics.std.item() == pytest.approx(x.double().std().item(), rel=1e-2)


def test_the_floor_bounds_a_feature_that_appears_for_the_first_time():
    dynamics = DynamicsModel(2, 1, std_floor=0.05)
    x = torch.zeros(10_000, 2)
    x[:, 0] = torch.randn(10_000)
    dynamics.update_statistics(x)
    appears = torch.tensor([[0.0, 1.0]])
    assert dynamics.standardize(appears)[0, 1] == pytest.approx(1 / 0.05)
    dynamics.update_statistics(appears)  # its own std would be .01
    assert dynamics.var[1].sqrt() == pytest.approx(0.01, rel=1e-2)
    assert dynamics.standardize(appears)[0, 1] == pytest.approx(1 / 0.05, rel=1e-3)


# -- prediction ------------------------------------------------------------------------------


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("rows", [(6,), (2, 3)])
def test_it_predicts_from_an_action_in_every_form(replicas, rows):
    dynamics = model(replicas)
    x = torch.randn(*replicas, *rows, S)
    index = torch.randint(A, (*replicas, *rows))
    expected = dynamics(x, index, "mean")
    one_hot = torch.nn.functional.one_hot(index, A)
    for action in (index.unsqueeze(-1), index.int(), one_hot, one_hot.bool(), one_hot.float()):
        torch.testing.assert_close(dynamics(x, action, "mean"), expected)


def test_a_single_action_and_a_continuous_one():
    x, force = torch.randn(6, S), torch.randn(6, 1)
    single = DynamicsModel(S, 1)
    assert torch.equal(single.inputs(x, torch.zeros(6, 1).long())[:, -1:], torch.ones(6, 1))
    assert torch.equal(single.inputs(x, force)[:, -1:], force)


@pytest.mark.parametrize(
    "settings", [{"noise_std": torch.nan}, {"std_floor": -1.0}, {"observation_size": 0}]
)
def test_bad_settings_are_named(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        DynamicsModel(**{"observation_size": S, "action_size": A, **settings})


@pytest.mark.parametrize(
    ("observation", "action", "name"),
    [
        ((3, 5, S), torch.zeros(3, 5).long(), "observation"),
        ((2, 5, S + 1), torch.zeros(2, 5).long(), "observation"),
        ((2, 5, S), torch.zeros(2, 4).long(), "action"),
        ((2, 5, S), torch.zeros(2, 5), "action"),
    ],
)
def test_shapes_that_do_not_fit_are_named(observation, action, name):
    with pytest.raises(ValueError, match=name):
        DynamicsModel(S, A, replicas=(2,))(torch.zeros(observation), action)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("batch", [(32,), (4, 8), (0,)])
@pytest.mark.parametrize("weighted", [False, True])
def test_value_and_gradient_are_those_of_the_definition(drawn_noise, replicas, batch, weighted):
    dynamics = model(replicas, torch.double, noise_std=0.7, prior_std=0.3)
    loss = DynamicsLoss(dynamics, kl_temperature=0.4)
    count = torch.Size(replicas).numel()
    num_data = torch.arange(10.0, 10.0 + count).double().reshape(replicas)
    loss.set_num_data(num_data)
    td = transitions(replicas, batch, dtype=torch.double)
    given, counts = td.clone(), torch.ones(td.shape, dtype=torch.bool)
    weight = torch.ones(td.shape, dtype=torch.double)
    if weighted:
        counts = torch.rand(td.shape) < 0.7
        counts.view(count, -1)[1:2] = False  # a replica without rows
        given["valid"], given["priority_weight"] = counts, weight.uniform_()
    weight = weight * counts
    # what does not count, and the state after an end, may be anything
    predicted = counts & ~td["next", "terminated"].squeeze(-1)
    given["observation"][~counts] = torch.nan
    given["action"][~counts] = 999
    given["next", "observation"][~predicted] = torch.nan
    if weighted:
        loss.set_keys(observation=("deep", "state"))
        for states in (given, given["next"]):
            states.rename_key_("observation", ("deep", "state"))
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
    number = weight.reshape(*replicas, -1).sum(-1).clamp_min(1e-300)
    kl = kl_divergence(q, Normal(0.0, 0.3)).sum(-1)
    expected = rows.reshape(*replicas, -1).sum(-1) / number + 0.4 * kl / num_data
    torch.testing.assert_close(out["dynamics_loss"], expected.detach())
    torch.testing.assert_close(out["dynamics_kl"], kl.detach())
    assert_learns(loss, out, expected)


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
