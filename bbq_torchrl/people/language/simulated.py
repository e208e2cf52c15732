"""Acts of simulated dialogues, for which there must be sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.frames import Coding
from bbq_torchrl.simulator import Simulator

if TYPE_CHECKING:
    from tensordict import TensorDict

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.domains.frames import Frame

_BATCH = 500


def play(
    domain: Domain, dialogues: int, *, seed: int = 0, kept: int = 4
) -> list[tuple[Frame | None, Frame]]:
    """Returns the acts of dialogues with agents that are half scripted, half random.

    Args:
        domain: the domain.
        dialogues: the number of dialogues, rounded up to whole batches.
        seed: the seed of users and agents.
        kept: the number of dialogues of a batch to record at each turn.

    Returns:
        The agent's act, ``None`` at the opening, and the user's act that follows.
    """
    tensors = tensorize(domain)
    simulator = Simulator(tensors)
    active = torch.ones(tensors.n_slots, dtype=torch.bool)
    generator = torch.Generator().manual_seed(seed)
    scripts = [p.steps for p in domain.policies.values() if p.kind == "script"]
    coding = Coding(tensors)
    ends = torch.tensor([action.act in ("thanks", "closing") for action in domain.actions])
    found = []
    for number in range(-(-dialogues // _BATCH)):
        state = simulator.reset(simulator.draw_reset((_BATCH,), generator), active)
        found += _frames(coding, state[:kept])
        steps = scripts[number % len(scripts)] if scripts else ()
        for turn in range(simulator.max_agent_turns):
            action = torch.randint(tensors.n_actions, (_BATCH,), generator=generator)
            is_early = torch.rand(_BATCH, generator=generator) > turn / 15
            action = torch.where(is_early & ends[action], tensors.n_actions - 1, action)
            if turn < len(steps):
                follows = torch.rand(_BATCH, generator=generator) < 0.6
                action = torch.where(follows, domain.action_index(steps[turn]), action)
            was_done = state["done"]
            state = simulator.turn(state, action, simulator.draw_turn((_BATCH,), generator), active)
            found += _frames(coding, state[~was_done][:kept])
            if bool(state["done"].all()):
                break
    return found


def _frames(coding: Coding, states: TensorDict) -> list[tuple[Frame | None, Frame]]:
    """Returns the agent's act and the user's act in each of the states ``[B]``."""
    users = _side(coding, states, "user_act", "meant_informs", "pending")
    agents = _side(coding, states, "agent_act", "agent_informs", "agent_requests")
    return [
        (None if act < 0 else agent, user)
        for act, agent, user in zip(states["agent_act"].tolist(), agents, users, strict=True)
    ]


def _side(coding: Coding, states: TensorDict, *keys: str) -> list[Frame]:
    """Returns one side's acts, from the keys of its act, values and questions."""
    columns = [states[key].tolist() for key in keys]
    return [coding.frame(*row) for row in zip(*columns, strict=True)]
