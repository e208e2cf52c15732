"""What is said in simulated dialogues: the acts that sentences must exist for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains import DONT_CARE, NONE, tensorize
from bbq_torchrl.language.frames import ANY, Frame
from bbq_torchrl.simulator import Simulator

if TYPE_CHECKING:
    from tensordict import TensorDict

    from bbq_torchrl.domains import Domain, DomainTensors

__all__ = ["Turns", "play"]

_BATCH = 500


class Turns:
    """Turns of simulated dialogues.

    Attributes:
        turns: the agent's act, what the tracker held before it, and what the user means.
        patterns: one turn for every act with other slots, by side.
    """

    def __init__(self) -> None:
        self.turns: list[tuple[Frame | None, dict[str, str], Frame]] = []
        self.patterns: dict[tuple[object, ...], tuple[Frame | None, dict[str, str], Frame]] = {}


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
    found = Turns()
    ends = torch.tensor([action.act in ("thanks", "closing") for action in domain.actions])
    for number in range(-(-dialogues // _BATCH)):
        state = simulator.reset(simulator.draw_reset((_BATCH,), generator), active)
        _keep(found, domain, tensors, state, state["held"], kept)
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
            _keep(found, domain, tensors, state[~was_done], held[~was_done], kept)
            if bool(state["done"].all()):
                break
    return found


def _keep(
    found: Turns,
    domain: Domain,
    tensors: DomainTensors,
    state: TensorDict,
    held: torch.Tensor,
    kept: int,
) -> None:
    if not state.batch_size[0]:
        return
    few = 4  # ids below this are reserved and read differently
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
        turn = _decoded(domain, tensors, state[row], held[row])
        if pattern is not None:
            found.patterns.setdefault(pattern, turn)
        if row < kept:
            found.turns.append(turn)


def _decoded(
    domain: Domain, tensors: DomainTensors, state: TensorDict, held: torch.Tensor
) -> tuple[Frame | None, dict[str, str], Frame]:
    user = _frame(domain, tensors, state["user_act"], state["meant_informs"], state["pending"])
    agent = None
    if int(state["agent_act"]) >= 0:
        agent = _frame(
            domain, tensors, state["agent_act"], state["agent_informs"], state["agent_requests"]
        )
    return agent, _values(domain, tensors, held), user


def _frame(
    domain: Domain,
    tensors: DomainTensors,
    act: torch.Tensor,
    informs: torch.Tensor,
    requests: torch.Tensor,
) -> Frame:
    asked = tuple(domain.slots[slot] for slot in requests.nonzero().flatten().tolist())
    return Frame(domain.acts[int(act)], _values(domain, tensors, informs), asked)


def _values(domain: Domain, tensors: DomainTensors, ids: torch.Tensor) -> dict[str, str]:
    return {
        domain.slots[slot]: ANY if value == DONT_CARE else tensors.vocabulary[slot][value]
        for slot, value in enumerate(ids.tolist())
        if value != NONE
    }
