"""Dialogues of the simulator as conversations of the study."""

from __future__ import annotations

from itertools import pairwise

import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.domains import Goal
from bbq_torchrl.domains.coding import Coding
from bbq_torchrl.envs import DialogueEnv, scripted_policy


class Conversations:
    """Plays dialogues without errors and yields each with the simulator's own outcome."""

    def __init__(self, domain, *, batch=500):
        self.env = DialogueEnv(domain, batch_size=(batch,), slot_error_prob=0.0, seed=0)
        self.coding = Coding(self.env.simulator.domain)

    def play(self, policy, random_share, seed, *, booking_share=0.0):
        """Yields (goal, exchanges, in time, success of the simulator)."""
        env, generator = self.env, torch.Generator().manual_seed(seed)
        env.set_seed(seed)
        policy = scripted_policy(policy, env)
        booking = torch.tensor(
            [
                env.domain.action_index(f"inform({env.domain.complete_slot})"),
                env.domain.action_index("thanks"),
            ]
        )
        tensordict = env.reset()
        states = [env.dialogues]
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            while not bool(states[-1]["done"].all()):
                tensordict = policy(tensordict)
                size = tensordict["action"].shape
                random = torch.randint(len(env.domain.actions), size, generator=generator)
                late = booking[torch.randint(2, size, generator=generator)]
                is_late = torch.rand(size, generator=generator) < booking_share
                random = torch.where(is_late, late, random)
                is_random = torch.rand(size, generator=generator) < random_share
                tensordict["action"] = torch.where(is_random, random, tensordict["action"])
                tensordict = env.step(tensordict)["next"]
                states.append(env.dialogues)
        stacked = [state.to_dict() for state in states]
        for place in range(env.batch_size[0]):
            yield self._conversation([{k: v[place] for k, v in s.items()} for s in stacked])

    def _conversation(self, states):
        end = next(number for number, state in enumerate(states) if bool(state["done"]))
        first, last = states[0], states[end]
        card = self._frame(0, first["constraints"], first["requests"])
        requests = [slot for slot in card.requests if slot != self.env.domain.ticket_slot]
        exchanges = [
            (
                self._frame(before["heard_act"], before["user_informs"], before["pending"]),
                self._frame(after["agent_act"], after["agent_informs"], after["agent_requests"]),
            )
            for before, after in pairwise(states[: end + 1])
        ]
        in_time = int(last["turn"]) <= self.env.simulator.max_turn
        return Goal(card.informs, tuple(requests)), exchanges, in_time, bool(last["success"])

    def _frame(self, act, informs, requests):
        return self.coding.frame(int(act), informs.tolist(), requests.tolist())
