"""Plays the same dialogues in the tensor simulator and in the oracle, and compares every turn."""

from collections import Counter
from random import Random

import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.frames import Coding
from bbq_torchrl.simulator import ErrorModel, Simulator

from .agents import StrayingAgent
from .dialogue import Dialogue, World

LANES = 2


class Comparison:
    """A batch of dialogues, played by simulator and oracle with the same random numbers."""

    def __init__(self, domain, setting, dialogues, seed, device="cpu"):
        tensors = tensorize(domain)
        errors = ErrorModel(
            tensors, setting.slot_error_prob, setting.slot_error_mode, setting.intent_error_prob
        )
        self.simulator = Simulator(
            tensors, errors=errors, max_turn=setting.max_turn, users=setting.users or "paper"
        ).to(device)
        self.world = World(domain, setting)
        self.active = torch.tensor([s in self.world.active for s in domain.slots], device=device)
        self.coding = Coding(tensors)
        self.shape = (LANES, dialogues // LANES)
        self.generator = torch.Generator(device).manual_seed(seed)
        self.random = Random(seed)
        self.said = [[] for _ in range(self.shape[0] * self.shape[1])]

    def play(self):
        """Plays all dialogues to their ends; raises an AssertionError at the first difference.

        Returns the number of times each rule applied, and the numbers of dialogues and successes.
        """
        mask = self.simulator.action_mask(self.active)
        assert mask.nonzero().flatten().tolist() == self.world.legal_actions()
        draws = self.simulator.draw_reset(self.shape, self.generator)
        state = self.simulator.reset(draws, self.active)
        going = list(range(draws.numel()))
        dialogues = [Dialogue(self.world, row) for row in rows_of(draws, going)]
        agents = [StrayingAgent(self.world, number, self.random) for number in going]
        self.compare(dialogues, going, state)
        while going:
            actions = [0] * len(dialogues)  # actions of ended dialogues have no effect
            for number in going:
                self.said[number].append(agents[number].act(dialogues[number]))
                actions[number] = self.world.domain.action_index(self.said[number][-1])
            action = torch.tensor(actions, device=self.active.device).view(self.shape)
            draws = self.simulator.draw_turn(self.shape, self.generator)
            before = state
            state = self.simulator.turn(state, action, draws, self.active)
            for number, row in zip(going, rows_of(draws, going), strict=True):
                dialogues[number].turn(self.world.domain.actions[actions[number]], row)
            self.compare(dialogues, going, state)
            assert_ended_dialogues_stay(before, state)
            going = [number for number in going if not dialogues[number].done]
        successes = sum(dialogue.success for dialogue in dialogues)
        return self.world.fired + Counter(dialogues=len(dialogues), successes=successes)

    def compare(self, dialogues, going, state):
        """Asserts that state and features of these dialogues equal the simulator's."""
        acts = state.exclude("traits")  # which the oracle draws in its own way
        got = {key: value.flatten(0, 1)[going].cpu() for key, value in acts.items()}
        features = self.simulator.observe(state, self.active)
        got["features"] = features.flatten(0, 1)[going].cpu()
        states = [self.state_of(dialogues[number]) for number in going]
        assert got.keys() == states[0].keys()
        for key, found in got.items():
            wanted = torch.tensor([one[key] for one in states], dtype=found.dtype)
            assert wanted.shape == found.shape, key
            differs = (wanted != found).reshape(len(going), -1).any(1).nonzero().flatten().tolist()
            if differs:
                row, dialogue = differs[0], dialogues[going[differs[0]]]
                raise AssertionError(
                    f"{key}: the oracle has {wanted[row].tolist()}, the simulator "
                    f"{found[row].tolist()}\nagent: {self.said[going[row]]}\n"
                    f"user: {vars(dialogue.user)}\ntracker: {vars(dialogue.tracker)}"
                )

    def state_of(self, dialogue):
        """Returns state and features of an oracle's dialogue in the simulator's ids."""
        user, tracker = dialogue.user, dialogue.tracker
        act, values, marks = self.world.acts.index, self.coding.ids, self.coding.flags
        return {
            "goal_id": dialogue.goal_number,
            "constraints": values(user.constraints),
            "requests": marks(user.requests),
            "agenda": marks(user.agenda),
            "pending": marks(user.pending),
            "history": values(user.history),
            "constraints_met": user.constraints_met,
            "user_act": act(user.act),
            "meant_informs": values(dialogue.meant_informs),
            "heard_act": act(tracker.heard_act),
            "user_informs": values(user.informs),
            "heard_requests": marks(user.pending),
            "open_requests": marks(user.pending),
            "held": values(tracker.held),
            "agent_act": -1 if tracker.agent_act is None else act(tracker.agent_act),
            "agent_informs": values(tracker.agent_informs),
            "agent_requests": marks(tracker.agent_requests),
            "turn": dialogue.turn_count,
            "repeats": 0,  # a channel of acts never asks users to repeat
            "done": dialogue.done,
            "success": dialogue.success,
            "reward": dialogue.reward,
            "features": dialogue.features(),
        }


def rows_of(draws, numbers):
    """Returns the draws of these dialogues as plain numbers and lists."""
    columns = {key: value.flatten(0, 1)[numbers].tolist() for key, value in draws.items()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def assert_ended_dialogues_stay(before, after):
    """Asserts that an ended dialogue stays unchanged, without further reward."""
    ended = before["done"]
    for key, value in after.items(True, True):
        stays = torch.zeros_like(before[key]) if key == "reward" else before[key]
        assert torch.equal(value[ended], stays[ended]), f"{key} changes after the end"
