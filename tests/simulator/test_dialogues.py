"""What the rules, which are spelled on the oracle, leave open: chance, rewards, lengths."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.simulator import Rewards, Simulator


def test_first_turns_draw_goals_constraints_and_requests_evenly(movie):
    domain = tensorize(movie)
    simulator, count = Simulator(domain), 40_000
    generator = torch.Generator().manual_seed(0)
    state = simulator.reset(
        simulator.draw_reset((count,), generator), torch.ones(domain.n_slots, dtype=torch.bool)
    )
    n_goals = domain.goal_constraints.shape[0]
    drawn = torch.bincount(state["goal_id"], minlength=n_goals) / count
    sigma = (1 / n_goals / count) ** 0.5
    assert (drawn - 1 / n_goals).abs().max() < 6 * sigma

    wanted = state["requests"].clone()
    wanted[:, domain.ticket] = False
    several = wanted.sum(-1) > 1
    first = (wanted & (wanted.cumsum(-1) == 1))[several]
    share = (state["pending"][several] & first).any(-1).double()
    expected = 1 / wanted[several].sum(-1).double()
    sigma = (expected * (1 - expected)).sum().sqrt() / several.sum()
    assert (share.mean() - expected.mean()).abs() < 5 * sigma


def test_rewards_are_what_they_were_set_to():
    was_done, is_done, success = torch.tensor(
        [[True, True, True], [False, True, True], [False, True, False], [False, False, False]]
    ).T
    paid = Rewards(success=3.0, failure=-2.0, turn=-0.5).of(was_done, is_done, success)
    assert paid.tolist() == [0, 3, -2, -0.5]
    with pytest.raises(ValueError, match="the reward for success must be finite, got nan"):
        Rewards(success=float("nan"))


def test_a_dialogue_has_as_many_turns_as_acts_for_both_and_one_too_many(movie):
    assert Simulator(tensorize(movie), max_turn=10).max_agent_turns == 6
    for max_turn in (1, 3.5, float("nan")):
        with pytest.raises(ValueError, match=f"a whole number of at least 2, got {max_turn}"):
            Simulator(tensorize(movie), max_turn=max_turn)
