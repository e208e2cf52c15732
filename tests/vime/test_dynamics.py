"""DynamicsModel: running statistics by their definition, actions in every form, replicas."""

import pytest
import torch
from dynamics_losses import model
from q_transitions import ACTIONS, FEATURES, REPLICAS, elements

from bbq_torchrl.vime import DynamicsModel

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


def test_a_replica_without_rows_keeps_its_statistics_bitwise():
    dynamics = model((2,))
    statistics = (dynamics.mean, dynamics.var, dynamics.count)
    before = [each.clone() for each in statistics]
    x = torch.randn(2, 5, S)
    x[1] = torch.nan
    dynamics.update_statistics(x, torch.tensor([[True] * 5, [False] * 5]))
    for now, then in zip(statistics, before, strict=True):
        assert torch.equal(now[1], then[1])
        assert not torch.equal(now[0], then[0])


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
def test_it_predicts_from_standardized_state_and_action_in_every_form(replicas, rows):
    dynamics = model(replicas)
    x = torch.randn(*replicas, *rows, S)
    index = torch.randint(A, (*replicas, *rows))
    shape = (*replicas, *(1 for _ in rows), S)
    mean, std = dynamics.mean.reshape(shape), dynamics.var.sqrt().reshape(shape)
    one_hot = torch.nn.functional.one_hot(index, A)
    expected = dynamics.network(torch.cat([(x - mean) / std, one_hot.float()], -1), "mean")
    forms = (index, index.unsqueeze(-1), index.int(), one_hot, one_hot.bool(), one_hot.float())
    for action in forms:
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
