"""How the tracker completes the agent's acts and what it remembers."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.simulator import Simulator

from .scenes import ACTIONS, cinema


def test_only_domains_with_multiple_choices_have_values_to_choose_from(movie):
    domain = tensorize(movie)
    tracker = Simulator(domain).tracker
    agent = tracker.complete(torch.zeros(domain.n_slots, dtype=torch.long), torch.tensor(0))
    with pytest.raises(ValueError, match="no action of kind 'multiple_choice'"):
        agent.choose(torch.tensor(0.5))


def test_the_tracker_knows_every_action_by_its_kind():
    domain = tensorize(cinema(Goal({})))
    tracker = Simulator(domain).tracker
    actions = torch.arange(len(ACTIONS))
    agent = tracker.complete(torch.zeros(len(ACTIONS), domain.n_slots, dtype=torch.long), actions)

    def named(flags):
        return {name for name, flag in zip(ACTIONS, flags.tolist(), strict=True) if flag}

    assert named(agent.is_request) == {name for name in ACTIONS if name.startswith("request(")}
    informs = {name for name in ACTIONS if name.startswith("inform(")}
    assert named(agent.is_inform) == informs - {"inform(done)"}
    assert named(agent.is_booking) == {"inform(done)"}
    assert named(agent.is_multiple_choice) == {"multiple_choice(theater)"}
    assert named(agent.is_confirm_answer) == {"confirm_answer"}
    assert named(agent.is_end) == {"thanks", "closing"}
