"""A scripted policy that detects misunderstandings and asks again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

MEMORY = "memory"
"""The entry with the policy's memory."""

MAX_CONFIRMS = 12
"""The limit on asking the user to continue."""

MAX_OFFERS = 3
"""The limit on offers of a booking."""


class RepairPolicy(TensorDictModuleBase):
    """Books from observations alone, and asks again after a misunderstanding.

    Each turn it takes the first action with a reason:

    1. The user has just thanked for the booking: end the dialogue.
    2. The user asks a question in the first turn: request the question's slot, which makes a
       simulated user inform all its constraints at once.
    3. No record matches the values held before any answer, or an offer was denied: request the
       filled slots again, in order; after a denial all of them once, otherwise until a record
       matches.
    4. The user asks a question: answer it.
    5. The user may have more to say: inform the ticket once, then ``confirm_answer`` until the user
       gives thanks, at most :data:`MAX_CONFIRMS` times.
    6. Offer the booking, at most :data:`MAX_OFFERS` times.
    7. End the dialogue.

    Its memory of requests, informs and offers is a nested TensorDict, the entry :data:`MEMORY`. It
    is a function of the observations so far, empty at the start of a dialogue. Rollouts and
    collectors pass it from turn to turn; other loops do so by ``step_mdp``.

    Args:
        env: a :class:`~bbq_torchrl.envs.DialogueEnv` with the domain's actions; transforms must not
            change the observation.
        slots: the slots that it requests again, in order.

    Raises:
        ValueError: if the domain lacks an action that the policy needs.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> from bbq_torchrl.envs import DialogueEnv
        >>> env = DialogueEnv(movie_domain(), batch_size=(3,), seed=0)
        >>> rollout = env.rollout(4, RepairPolicy(env, ["moviename", "city", "date"]))
        >>> rollout["memory", "asked"].shape
        torch.Size([3, 4, 29])
    """

    def __init__(self, env: EnvBase, slots: Sequence[str]) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["observation", "action_mask"], ["action", MEMORY]
        domain, self._layout = env.domain, env.layout
        names, ordinary = domain.action_names, set(domain.slots) - set(domain.special_slots)
        askable, answers = (
            [slot for slot in domain.slots if slot in ordinary and f"{act}({slot})" in names]
            for act in ("request", "inform")
        )
        plan = [
            *(f"request({slot})" for slot in (*askable, *slots)),
            *(f"inform({slot})" for slot in answers),
            f"inform({domain.ticket_slot})",
            "confirm_answer",
            f"inform({domain.complete_slot})",
            "thanks",
        ]
        self._plan = indices(domain.action_index(name) for name in plan)
        self._askable, self._slots, self._answers = (
            indices(domain.slots.index(slot) for slot in some) for some in (askable, slots, answers)
        )
        self._n_slots = len(domain.slots)
        self._ticket = domain.slots.index(domain.ticket_slot)
        self._complete = domain.slots.index(domain.complete_slot)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the next action and the memory."""
        flags, is_legal = tensordict.get("observation") > 0, tensordict.get("action_mask")
        layout, column = self._layout, self._layout.column
        is_first = ~flags[..., layout["agent_act"]].any(-1, keepdim=True)
        is_thanked = flags[..., column("user_act", "thanks"), None]
        nothing_matches = ~flags[..., column("kb_match", "all"), None]
        told = flags[..., layout["agent_informed"]]
        has_offered = told[..., self._complete, None]
        filled, questions = flags[..., layout["filled"]], flags[..., layout["user_requested"]]

        memory = self._remembered(tensordict, is_first)
        asked = memory["asked"] | flags[..., layout["agent_requested"]]
        told = memory["told"] | told & ~has_offered
        offers = memory["offers"] + has_offered
        confirms = memory["confirms"] + flags[..., column("agent_act", "confirm_answer"), None]
        confirms = torch.where(is_thanked, MAX_CONFIRMS, confirms)

        has_answered = told[..., self._answers].any(-1, keepdim=True)
        is_misheard = nothing_matches & ~has_answered
        again = (filled & ~told)[..., self._slots]
        left = again & ~asked[..., self._slots]
        begins = has_offered | (is_misheard & ~left.any(-1, keepdim=True))
        asked, left = asked & ~begins, torch.where(begins, again, left)

        may_confirm = confirms < MAX_CONFIRMS
        reasons = [
            questions[..., self._askable] & is_first,
            left & (is_misheard | (offers > 0)),
            questions[..., self._answers],
            may_confirm & ~filled[..., self._ticket, None],
            may_confirm,
            offers < MAX_OFFERS,
        ]
        ends = torch.ones_like(is_first)
        is_open = torch.cat([torch.cat(reasons, -1) & ~(has_offered & is_thanked), ends], -1)
        is_open = is_open & is_legal[..., self._plan]
        remembered = {"asked": asked, "told": told, "confirms": confirms, "offers": offers}
        tensordict.set(MEMORY, TensorDict(remembered, batch_size=tensordict.batch_size))
        return tensordict.set("action", self._plan[is_open.to(torch.uint8).argmax(-1)])

    def _remembered(self, tensordict: TensorDictBase, is_first: torch.Tensor) -> TensorDictBase:
        """Returns the memory of earlier turns, empty at the start of a dialogue.

        Raises:
            ValueError: if a dialogue in progress lacks it.
        """
        memory = tensordict.get(MEMORY, None)
        if memory is not None:
            return memory.apply(lambda entry: entry * ~is_first)
        if not bool(is_first.all()):
            raise ValueError(
                f"the entry {MEMORY!r} is missing in a dialogue in progress: pass it from step to "
                "step, as step_mdp(env.step(tensordict)) does"
            )
        nothing = torch.zeros_like(is_first, dtype=torch.int64)
        no_slot = torch.zeros_like(is_first).repeat_interleave(self._n_slots, -1)
        empty = {"asked": no_slot, "told": no_slot, "confirms": nothing, "offers": nothing}
        return TensorDict(empty, batch_size=tensordict.batch_size)


def indices(numbers: Iterable[int]) -> torch.nn.Buffer:
    """Returns indices as an int64 buffer, which moves with its module."""
    return torch.nn.Buffer(torch.tensor(list(numbers), dtype=torch.int64))
