"""Plays the same dialogues in the tensor simulator and in the oracle, and compares every turn."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING, Any

import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.simulator import ErrorModel, Simulator

from .agents import StrayingAgent
from .dialogue import Dialogue, World
from .values import plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from tensordict import TensorDict

    from bbq_torchrl.domains import Domain, DomainTensors

    from .dialogue import Setting

LANES = 2


@dataclass
class Played:
    """What a comparison has covered."""

    dialogues: int = 0
    turns: int = 0
    successes: int = 0
    fired: Counter[str] = field(default_factory=Counter)


class Codec:
    """Writes an oracle's state as the simulator's ids."""

    def __init__(self, tensors: DomainTensors) -> None:
        self.slots = list(tensors.slot)
        self.acts = list(tensors.act)
        self.place = tensors.slot
        self.value_number = {
            slot: {plain(text): number for number, text in enumerate(texts) if number > 0}
            for slot, texts in zip(self.slots, tensors.vocabulary, strict=True)
        }

    def values(self, held: Mapping[str, str]) -> list[int]:
        """Returns each slot's value id, 0 where nothing is held."""
        row = [0] * len(self.slots)
        for slot, value in held.items():
            row[self.place[slot]] = self.value_number[slot][value]
        return row

    def marks(self, chosen: Iterable[str]) -> list[bool]:
        """Returns whether each slot is among the chosen."""
        row = [False] * len(self.slots)
        for slot in chosen:
            row[self.place[slot]] = True
        return row

    def act(self, act: str | None) -> int:
        """Returns the act's id, -1 for none."""
        return -1 if act is None else self.acts.index(act)

    def state(self, dialogue: Dialogue) -> dict[str, Any]:
        """Returns everything that the simulator's state holds of a dialogue."""
        user, tracker = dialogue.user, dialogue.tracker
        return {
            "goal_id": dialogue.goal_number,
            "constraints": self.values(user.constraints),
            "requests": self.marks(user.requests),
            "agenda": self.marks(user.agenda),
            "pending": self.marks(user.pending),
            "history": self.values(user.history),
            "constraints_met": user.constraints_met,
            "user_act": self.act(user.act),
            "meant_informs": self.values(dialogue.meant_informs),
            "heard_act": self.act(tracker.heard_act),
            "user_informs": self.values(user.informs),
            "heard_requests": self.marks(user.pending),
            "open_requests": self.marks(user.pending),
            "held": self.values(tracker.held),
            "agent_act": self.act(tracker.agent_act),
            "agent_informs": self.values(tracker.agent_informs),
            "agent_requests": self.marks(tracker.agent_requests),
            "turn": dialogue.turn_count,
            "repeats": 0,  # nobody is asked again about an act
            "done": dialogue.done,
            "success": dialogue.success,
            "reward": dialogue.reward,
        }


class Comparison:
    """One batch of dialogues, played on both sides with the same random numbers."""

    def __init__(
        self,
        domain: Domain,
        setting: Setting,
        dialogues: int,
        seed: int,
        device: torch.device | str = "cpu",
    ) -> None:
        tensors = tensorize(domain)
        errors = ErrorModel(
            tensors, setting.slot_error_prob, setting.slot_error_mode, setting.intent_error_prob
        )
        self.simulator = Simulator(tensors, errors=errors, max_turn=setting.max_turn).to(device)
        self.world = World(domain, setting)
        self.active = torch.tensor([s in self.world.active for s in domain.slots], device=device)
        self.codec = Codec(tensors)
        self.shape = (LANES, dialogues // LANES)
        self.generator = torch.Generator(device).manual_seed(seed)
        self.random = Random(seed)
        self.said: list[list[str]] = [[] for _ in range(self.shape[0] * self.shape[1])]

    def play(self) -> Played:
        """Plays all dialogues to their ends; raises an AssertionError at the first difference."""
        mask = self.simulator.action_mask(self.active)
        assert mask.nonzero().flatten().tolist() == self.world.legal_actions()
        draws = self.simulator.draw_reset(self.shape, self.generator)
        state = self.simulator.reset(draws, self.active)
        going = list(range(draws.numel()))
        dialogues = [Dialogue(self.world, row) for row in rows_of(draws, going)]
        agents = [
            StrayingAgent(self.world, number, self.random) for number in range(len(dialogues))
        ]
        self.compare(dialogues, going, state)
        turns = 0
        while going:
            actions = self.speak(dialogues, agents, going)
            draws = self.simulator.draw_turn(self.shape, self.generator)
            before = state
            state = self.simulator.turn(state, actions, draws, self.active)
            said = actions.flatten()[going].tolist()
            for number, action, row in zip(going, said, rows_of(draws, going), strict=True):
                dialogues[number].turn(self.world.domain.actions[action], row)
            self.compare(dialogues, going, state)
            assert_ended_dialogues_stay(before, state)
            turns += len(going)
            going = [number for number in going if not dialogues[number].done]
        successes = sum(dialogue.success for dialogue in dialogues)
        return Played(len(dialogues), turns, successes, self.world.fired)

    def speak(
        self, dialogues: list[Dialogue], agents: list[StrayingAgent], going: list[int]
    ) -> torch.Tensor:
        """Returns everyone's action; those that have ended get one that must change nothing."""
        actions = [0] * len(dialogues)
        for number in going:
            name = agents[number].act(dialogues[number])
            self.said[number].append(name)
            actions[number] = self.world.action_names.index(name)
        return torch.tensor(actions, device=self.active.device).view(self.shape)

    def compare(self, dialogues: list[Dialogue], going: list[int], state: TensorDict) -> None:
        """Asserts that state and features of these dialogues are those of the simulator."""
        got = {key: value.flatten(0, 1)[going].cpu() for key, value in state.items()}
        features = self.simulator.observe(state, self.active)
        got["features"] = features.flatten(0, 1)[going].cpu()
        states = [self.codec.state(dialogues[number]) for number in going]
        expected = {key: [one[key] for one in states] for key in states[0]}
        expected["features"] = [dialogues[number].features() for number in going]
        assert got.keys() == expected.keys()
        for key, values in expected.items():
            wanted, found = torch.tensor(values, dtype=got[key].dtype), got[key]
            assert wanted.shape == found.shape, key
            differs = (wanted != found).reshape(len(going), -1).any(1).nonzero().flatten().tolist()
            if differs:
                row, dialogue = differs[0], dialogues[going[differs[0]]]
                raise AssertionError(
                    f"{key}: the oracle has {wanted[row].tolist()}, the simulator "
                    f"{found[row].tolist()}\nagent: {self.said[going[row]]}\n"
                    f"user: {vars(dialogue.user)}\ntracker: {vars(dialogue.tracker)}"
                )


def rows_of(draws: TensorDict, numbers: list[int]) -> list[dict[str, Any]]:
    """Returns the draws of these dialogues as plain numbers and lists."""
    columns = {key: value.flatten(0, 1)[numbers].tolist() for key, value in draws.items()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def assert_ended_dialogues_stay(before: TensorDict, after: TensorDict) -> None:
    """Asserts that a dialogue that had ended is as it was, and earns nothing more."""
    ended = before["done"]
    for key, value in after.items():
        stays = torch.zeros_like(before[key]) if key == "reward" else before[key]
        assert torch.equal(value[ended], stays[ended]), f"{key} changes after the end"
