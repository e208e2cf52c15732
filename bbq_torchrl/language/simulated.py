"""What is said in simulated dialogues: the acts that sentences must exist for."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch

from bbq_torchrl.domains import FIRST_VALUE, tensorize
from bbq_torchrl.language.coding import Coding
from bbq_torchrl.simulator import Simulator

if TYPE_CHECKING:
    from tensordict import TensorDict

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.language.frames import Frame

__all__ = ["Turns", "play"]

_BATCH = 500


class Turns(NamedTuple):
    """Turns of simulated dialogues.

    Attributes:
        turns: the agent's act, what the tracker held before it, and what the user means.
        patterns: one turn for every act with other slots, by side.
    """

    turns: list[tuple[Frame | None, dict[str, str], Frame]]
    patterns: dict[tuple[int, ...], tuple[Frame | None, dict[str, str], Frame]]


def play(domain: Domain, dialogues: int, *, seed: int = 0, kept: int = 4) -> Turns:
    """Returns what is said in dialogues of agents that are half scripted, half random.

    Args:
        domain: what is spoken of.
        dialogues: how many, rounded up to whole batches.
        seed: draws users and agents.
        kept: how many dialogues of a batch are kept whole; of the others only turns whose act has
            slots that no turn before had.
    """
    tensors = tensorize(domain)
    simulator = Simulator(tensors)
    active = torch.ones(tensors.n_slots, dtype=torch.bool)
    generator = torch.Generator().manual_seed(seed)
    scripts = [p.steps for p in domain.policies.values() if p.kind == "script"]
    found, coding = Turns([], {}), Coding(tensors)
    ends = torch.tensor([action.act in ("thanks", "closing") for action in domain.actions])
    for number in range(-(-dialogues // _BATCH)):
        state = simulator.reset(simulator.draw_reset((_BATCH,), generator), active)
        _keep(found, coding, state, state["held"], kept)
        steps = scripts[number % len(scripts)] if scripts else ()
        for turn in range(simulator.max_agent_turns):
            action = torch.randint(tensors.n_actions, (_BATCH,), generator=generator)
            is_early = torch.rand(_BATCH, generator=generator) > turn / 15
            action = torch.where(is_early & ends[action], tensors.n_actions - 1, action)
            if turn < len(steps):
                follows = torch.rand(_BATCH, generator=generator) < 0.6
                action = torch.where(follows, domain.action_index(steps[turn]), action)
            held, was_done = state["held"], state["done"]
            state = simulator.turn(state, action, simulator.draw_turn((_BATCH,), generator), active)
            _keep(found, coding, state[~was_done], held[~was_done], kept)
            if bool(state["done"].all()):
                break
    return found


def _keep(found: Turns, coding: Coding, state: TensorDict, held: torch.Tensor, kept: int) -> None:
    few = FIRST_VALUE  # ids below are reserved and read differently
    rows = torch.cat(
        [
            state["agent_act"][:, None],
            state["agent_informs"].clamp(max=few),
            state["agent_requests"].long(),
            state["user_act"][:, None],
            state["meant_informs"].clamp(max=few),
            state["pending"].long(),
        ],
        -1,
    )
    distinct, index = torch.unique(rows, dim=0, return_inverse=True)
    first = torch.full((len(distinct),), len(rows)).scatter_reduce_(
        0, index, torch.arange(len(rows)), "amin"
    )
    wanted = dict(zip(first.tolist(), map(tuple, distinct.tolist()), strict=True))
    for row in {*range(min(kept, len(rows))), *wanted}:
        pattern = wanted.get(row)
        if row >= kept and (pattern is None or pattern in found.patterns):
            continue
        turn = _decoded(coding, state[row], held[row])
        if pattern is not None:
            found.patterns.setdefault(pattern, turn)
        if row < kept:
            found.turns.append(turn)


def _decoded(
    coding: Coding, state: TensorDict, held: torch.Tensor
) -> tuple[Frame | None, dict[str, str], Frame]:
    user = _frame(coding, state, "user_act", "meant_informs", "pending")
    agent = None
    if int(state["agent_act"]) >= 0:
        agent = _frame(coding, state, "agent_act", "agent_informs", "agent_requests")
    return agent, coding.values(held.tolist()), user


def _frame(coding: Coding, state: TensorDict, act: str, informs: str, requests: str) -> Frame:
    return coding.frame(int(state[act]), state[informs].tolist(), state[requests].tolist())
