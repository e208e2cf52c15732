"""Dialogues of the simulator, turn by turn and as conversations of the study."""

from itertools import pairwise

import torch
from torchrl.envs.utils import step_mdp

from bbq_torchrl.domains import Goal
from bbq_torchrl.domains.frames import Coding
from bbq_torchrl.envs import DialogueEnv, scripted_policy


class Dialogues:
    """A batch of dialogues, with the states of all turns and the actions between them.

    The policy takes random actions at times, a share of which are offers and farewells.
    """

    def __init__(
        self, domain, batch, policy="careful", *, random_share, booking_share, errors=0.0, seed=0
    ):
        self.env = env = DialogueEnv(domain, batch_size=(batch,), slot_error_prob=errors, seed=seed)
        self.coding = Coding(env.simulator.domain)
        policy, generator = scripted_policy(policy, env), torch.Generator().manual_seed(seed)
        ends = map(domain.action_index, (f"inform({domain.complete_slot})", "thanks"))
        drawn_from = {
            random_share: torch.arange(len(domain.actions)),
            random_share * booking_share: torch.tensor(list(ends)),
        }
        tensordict = env.reset()
        self.states, self.actions = [env.dialogues], []
        while not bool(self.states[-1]["done"].all()):
            tensordict = policy(tensordict)
            for share, choices in drawn_from.items():
                drawn = choices[torch.randint(len(choices), (batch,), generator=generator)]
                is_drawn = torch.rand(batch, generator=generator) < share
                tensordict["action"] = torch.where(is_drawn, drawn, tensordict["action"])
            self.actions.append(tensordict["action"])
            tensordict = step_mdp(env.step(tensordict))
            self.states.append(env.dialogues)

    def turns(self, place):
        """The states of one dialogue, its end included."""
        for state in self.states:
            yield state[place]
            if bool(state["done"][place]):
                return

    def heard(self, state):
        return self._frame(state["heard_act"], state["user_informs"], state["heard_requests"])

    def conversations(self):
        """Yields (goal, exchanges, in time, success of the simulator)."""
        for place in range(self.env.batch_size[0]):
            states = list(self.turns(place))
            first, last = states[0], states[-1]
            card = self._frame(torch.tensor(0), first["constraints"], first["requests"])
            requests = [slot for slot in card.requests if slot != self.env.domain.ticket_slot]
            said = ("agent_act", "agent_informs", "agent_requests")
            exchanges = [
                (self.heard(before), self._frame(*(after[key] for key in said)))
                for before, after in pairwise(states)
            ]
            in_time = int(last["turn"]) <= self.env.simulator.max_turn
            yield Goal(card.informs, tuple(requests)), exchanges, in_time, bool(last["success"])

    def _frame(self, act, informs, requests):
        return self.coding.frame(int(act), informs.tolist(), requests.tolist())
