"""Boltzmann and ε-greedy: what they draw, and schedules of each part of a batch."""

import pytest
import torch
from q_actor import all_legal
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.data import Categorical, OneHot
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.exploration import BatchedEGreedy, Boltzmann
from bbq_torchrl.networks import q_actor

STARTS, ENDS = torch.tensor([[0.9], [0.5], [0.3]]), torch.tensor([[0.1], [0.5], [0.2]])


def epsilon(start, end, steps=4, **by):
    return BatchedEGreedy(Categorical(5), start, end, steps, action_mask_key="action_mask", **by)


def value(explore):
    return explore.temperature if isinstance(explore, Boltzmann) else explore.eps


@pytest.mark.parametrize("make", [Boltzmann, epsilon])
def test_each_part_of_a_batch_has_a_linear_schedule_whose_place_is_in_the_state(make):
    start = STARTS.clone()
    explore, loaded = make(start, ENDS, 4), make(STARTS, ENDS, 4)
    for fraction in (0.25, 0.5, 0.75, 1.0, 1.0, 1.0):
        explore.step()
        torch.testing.assert_close(value(explore), STARTS + fraction * (ENDS - STARTS))
        loaded.load_state_dict(explore.state_dict())
        assert torch.equal(value(loaded), value(explore))
    assert torch.equal(start, STARTS)  # what was given is not what the schedule moves
    with_one_number = make(STARTS, 0.1, 4)
    with_one_number.step(100)
    torch.testing.assert_close(value(with_one_number), torch.full((3, 1), 0.1))


@pytest.mark.parametrize("scale", [0.0, 1e-30, 1e6, 1e30])
def test_boltzmann_survives_any_scale_of_q(scale):
    mask = torch.tensor([True, True, False, True]).expand(500, 4)
    td = TensorDict(action_value=scale * torch.randn(500, 4), action_mask=mask)
    assert all_legal(Boltzmann(1e-3, 1e-3, 1)(td))


@pytest.mark.parametrize("spec", [Categorical(3), OneHot(3)])
def test_boltzmann_draws_an_action_in_the_form_of_the_greedy_one(spec):
    actor = q_actor(torch.nn.Linear(2, 3), spec, action_mask_key=None)
    policy = TensorDictSequential(actor, Boltzmann(1e6, 1e6, 1, action_mask_key=None))
    td = TensorDict(observation=torch.ones(300, 2), batch_size=[300])
    with set_exploration_type(ExplorationType.DETERMINISTIC):  # it is not to explore
        assert torch.equal(policy(td.clone())["action"], actor(td.clone())["action"])
    assert "action_mask" not in policy.in_keys
    action = policy(td)["action"]
    assert spec.expand(300, *spec.shape).is_in(action.to(spec.dtype))
    # 300 draws at so high a temperature miss one of three actions with probability 1e-52
    assert action.unique(dim=0).shape[0] == 3


@pytest.mark.parametrize(
    ("make", "start", "end", "message"),
    [
        (epsilon, 0.1, 0.2, "eps_init"),
        (epsilon, 1.5, 0.1, "eps_init"),
        (epsilon, 0.1, -0.1, "eps_init"),
        (Boltzmann, 0.1, 0.2, "temperature_init"),
        (Boltzmann, 0.1, 0.0, "temperature_init"),
    ],
)
def test_what_is_no_schedule_is_refused(make, start, end, message):
    with pytest.raises(ValueError, match=message):
        make(torch.tensor([[0.5], [start]]), torch.tensor([[0.1], [end]]), 4)
    with pytest.raises(ValueError, match="annealing_num_steps"):
        make(0.5, 0.1, 0)


@pytest.mark.parametrize("make", [Boltzmann, epsilon])
def test_with_success_a_schedule_falls_and_rises_by_a_running_mean(make):
    explore, loaded = (make(STARTS, ENDS, until_success=0.5) for _ in range(2))
    rates = torch.tensor([[0, 1, 1, 1, 0, 0], [0.2, 0, 0, 0, 0, 1], [1, 1, 1, 1, 1, 0]]).double()
    for played in range(1, 7):
        explore.step(100)  # a round changes nothing, only success does
        explore.see_success(rates[:, played - 1])
        for replica, own in enumerate(rates[:, :played].tolist()):
            mean = sum(0.2 * rate * 0.8**ago for ago, rate in enumerate(reversed(own)))
            start, end = float(STARTS[replica]), float(ENDS[replica])
            expected = end + (start - end) * max(0.0, 1 - mean / 0.5)
            assert float(value(explore)[replica]) == pytest.approx(expected, abs=1e-6)
        loaded.load_state_dict(explore.state_dict())
        assert torch.equal(value(loaded), value(explore))
