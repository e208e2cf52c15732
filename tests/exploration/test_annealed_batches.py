"""Schedules with values of their own along the batch; tests/cli/test_values.py has how they act."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Categorical

from bbq_torchrl.exploration import BatchedEGreedy, Boltzmann

ACTIONS, STEPS = 5, 4
STARTS, ENDS = (0.9, 0.5, 0.3), (0.1, 0.5, 0.2)


def column(values):
    return torch.tensor(values).unsqueeze(-1)


def explorer(kind, start, end):
    if kind == "temperature":
        return Boltzmann(start, end, STEPS)
    return BatchedEGreedy(Categorical(ACTIONS), start, end, STEPS, action_mask_key="action_mask")


def value(module):
    return module.temperature if isinstance(module, Boltzmann) else module.eps


@pytest.mark.parametrize("kind", ["epsilon", "temperature"])
def test_one_number_goes_with_several(kind):
    module = explorer(kind, column(STARTS), 0.1)
    module.step(100)
    torch.testing.assert_close(value(module), torch.full((3, 1), 0.1))


@pytest.mark.parametrize("kind", ["epsilon", "temperature"])
def test_the_place_in_the_schedule_is_in_the_state(kind):
    module, other = (explorer(kind, column(STARTS), column(ENDS)) for _ in range(2))
    module.step(3)
    other.load_state_dict(module.state_dict())
    for _ in range(2):
        assert torch.equal(value(other), value(module))
        for each in (module, other):
            each.step()
    # What was given is not what the schedule moves.
    start = column(STARTS)
    explorer(kind, start, column(ENDS)).step(2)
    assert torch.equal(start, column(STARTS))


@pytest.mark.parametrize(
    ("kind", "start", "end"),
    [
        ("epsilon", 0.1, 0.2),
        ("epsilon", 1.5, 0.1),
        ("epsilon", 0.1, -0.1),
        ("temperature", 0.1, 0.2),
        ("temperature", 0.1, 0.0),
    ],
)
def test_what_is_no_schedule_is_refused(kind, start, end):
    name = "eps" if kind == "epsilon" else kind
    with pytest.raises(ValueError, match=f"{name}_init must be at least {name}_end and"):
        explorer(kind, column((0.5, start)), column((0.1, end)))


@pytest.mark.parametrize("kind", ["epsilon", "temperature"])
@pytest.mark.parametrize("batch", [(3,), (4, 2), ()])
def test_values_that_do_not_fit_the_batch_are_refused(kind, batch):
    explore = explorer(kind, column(STARTS), column(ENDS))
    td = TensorDict(action=torch.zeros(batch).long(), batch_size=batch)
    td["action_value"] = torch.zeros(*batch, ACTIONS)
    td["action_mask"] = torch.ones(*batch, ACTIONS).bool()
    with pytest.raises(ValueError, match=r"shape \[3, 1\] must broadcast with the batch, got"):
        explore(td)


def test_a_schedule_without_a_step_is_refused():
    with pytest.raises(ValueError, match="annealing_num_steps must be at least 1, got 0"):
        BatchedEGreedy(Categorical(3), 0.5, 0.1, 0)
    with pytest.raises(ValueError, match="annealing_num_steps must be at least 1, got 0"):
        Boltzmann(0.5, 0.1, 0)
