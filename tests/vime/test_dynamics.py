"""DynamicsModel: running statistics by their definition, actions in every form, replicas."""

from __future__ import annotations

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
    stored, counted = [], []
    for rows in (1, 7, 30):
        x = 5 + 2 * torch.randn(*replicas, rows, S, dtype=dtype)
        valid = torch.rand(*replicas, rows) < 0.6
        dynamics.update_statistics(torch.where(valid.unsqueeze(-1), x, torch.nan), valid)
        stored.append(x)
        counted.append(valid)
    x, valid = (elements(torch.cat(t, len(replicas)), replicas) for t in (stored, counted))
    for k in range(len(x)):
        rows = x[k][valid[k]].double()
        if not len(rows):
            continue
        assert elements(dynamics.count, replicas).reshape(-1)[k] == len(rows)
        mean, var = rows.mean(0), rows.var(0, unbiased=False)
        torch.testing.assert_close(
            elements(dynamics.mean, replicas)[k].double(), mean, rtol=1e-5, atol=1e-6
        )
        torch.testing.assert_close(
            elements(dynamics.var, replicas)[k].double(), var, rtol=1e-4, atol=1e-5
        )


def test_statistics_do_not_drift_far_from_the_origin():
    # float32 sums of squares would lose everything here
    dynamics = DynamicsModel(1, 1)
    x = 3000 + 0.5 * torch.randn(4000, 1)
    for piece in x.split(100):
        dynamics.update_statistics(piece)
    assert dynamics.mean.item() == pytest.approx(x.double().mean().item(), rel=1e-6)
    assert dynamics.std.item() == pytest.approx(x.double().std().item(), rel=1e-2)


def test_an_element_without_rows_keeps_its_statistics_bitwise():
    dynamics = model((2,))
    before = {name: b.clone() for name, b in dynamics.named_buffers()}
    valid = torch.tensor([[True] * 5, [False] * 5])
    x = torch.randn(2, 5, S)
    x[1] = torch.nan
    dynamics.update_statistics(x, valid)
    for name in ("mean", "var", "count"):
        now = getattr(dynamics, name)
        assert torch.equal(now[1], before[name][1])
        assert not torch.equal(now[0], before[name][0])


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
def test_it_predicts_from_standardized_state_and_one_hot_action(replicas, rows):
    dynamics = model(replicas, dtype=torch.double)
    x = torch.randn(*replicas, *rows, S, dtype=torch.double)
    action = torch.randint(A, (*replicas, *rows))
    out = dynamics(x, action, "mean")
    assert out.shape == (*replicas, *rows, S)
    shape = (*replicas, *(1 for _ in rows), S)
    mean, std = dynamics.mean.reshape(shape), dynamics.var.sqrt().reshape(shape)
    one_hot = torch.nn.functional.one_hot(action, A).double()
    expected = dynamics.network(torch.cat([(x - mean) / std, one_hot], -1), "mean")
    torch.testing.assert_close(out, expected)


@pytest.mark.parametrize("replicas", [(), (3,)])
def test_every_form_of_an_action_is_understood(replicas):
    dynamics = model(replicas)
    x, index = torch.randn(*replicas, 6, S), torch.randint(A, (*replicas, 6))
    expected = dynamics(x, index)
    one_hot = torch.nn.functional.one_hot(index, A)
    for action in (index.unsqueeze(-1), index.int(), one_hot, one_hot.bool(), one_hot.float()):
        assert torch.equal(dynamics(x, action), expected)


def test_a_single_action_and_a_continuous_one():
    x = torch.randn(6, S)
    single = DynamicsModel(S, 1)
    assert torch.equal(single.encode_action(torch.zeros(6, 1).long(), (6,)), torch.ones(6, 1))
    force = torch.randn(6, 1)
    assert torch.equal(single.inputs(x, force)[:, -1:], force)


def test_observations_may_be_of_any_dtype():
    dynamics = DynamicsModel(S, A)
    bits = torch.rand(6, S) < 0.5
    action = torch.zeros(6).long()
    assert torch.equal(dynamics(bits, action), dynamics(bits.float(), action))


# -- errors ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"noise_std": float("nan")}, "noise_std must be positive and finite, got nan"),
        ({"std_floor": -1.0}, "std_floor must be positive and finite, got -1.0"),
        ({"observation_size": 0}, "observation_size must be at least 1, got 0"),
        ({"action_size": -1}, "action_size must be at least 1, got -1"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(ValueError, match=message):
        DynamicsModel(**{"observation_size": S, "action_size": A, **settings})


def test_shapes_that_do_not_fit_are_named():
    dynamics = DynamicsModel(S, A, replicas=(2,))
    with pytest.raises(ValueError, match=r"observation must have shape \[2, \*batch, 5\]"):
        dynamics.standardize(torch.zeros(3, 5, S))
    with pytest.raises(ValueError, match=r"observation must have shape \[2, \*batch, 5\]"):
        dynamics.update_statistics(torch.zeros(2, 5, S + 1))
    with pytest.raises(ValueError, match=r"action must be an index of shape \[2, 5\] or .*2, 5, 4"):
        dynamics(torch.zeros(2, 5, S), torch.zeros(2, 4).long())
    with pytest.raises(ValueError, match="action must be an index"):
        dynamics(torch.zeros(2, 5, S), torch.zeros(2, 5))  # an index must not be floating
