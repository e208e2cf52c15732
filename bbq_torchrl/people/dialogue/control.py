"""Rules between the Q-values and the sentence: manners that the simulated user never taught.

The simulated user repeats its questions until they are answered and does not mind repetition,
so an agent that learned from it loses nothing by bad manners. People do mind. A rule leaves out
actions, or forgets values that stand in the way. ``scripts/measure_control.py`` measures the cost
of each rule in the simulator (``results/control.csv``). The rules are on in chat and study, and off
in experiments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains.tensors import one_hot
from bbq_torchrl.domains.values import AVAILABLE, DONT_CARE, FIRST_VALUE, NO_MATCH, NONE
from bbq_torchrl.people.dialogue import RULES
from bbq_torchrl.people.dialogue.records import Records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from tensordict import TensorDictBase

    from bbq_torchrl.simulator import Simulator


class Control:
    """Applies rules in order, each only where it leaves an action.

    Args:
        simulator: the domain's simulator; its tracker completes the agent's acts.
        rules: names of :data:`~bbq_torchrl.people.dialogue.RULES`.

    Attributes:
        rules: the names, in the order in which they apply.
        records: the domain's records.

    Raises:
        ValueError: a name is unknown.
    """

    def __init__(self, simulator: Simulator, rules: Iterable[str] | None = None) -> None:
        names = list(RULES if rules is None else rules)
        for name in names:
            if name not in RULES:
                raise ValueError(f"a rule must be one of {', '.join(RULES)}, got {name!r}")
        self.rules = tuple(name for name in RULES if name in names)
        domain = simulator.domain
        self._tracker, self.records = simulator.tracker, Records(domain)
        self._acts, self._complete = domain.act, domain.complete
        self._act, self._slot = domain.action_act, domain.action_slot.clamp(min=0)
        has_slot = domain.action_slot >= 0
        is_inform = has_slot & (domain.action_act == domain.act["inform"])
        self._is_booking = is_inform & (domain.action_slot == domain.complete)
        self._is_told = is_inform & ~self._is_booking
        self._is_answer = self._is_told & (domain.action_slot != domain.ticket)
        self._is_request = has_slot & (domain.action_act == domain.act["request"])
        self._is_end = (domain.action_act == domain.act["thanks"]) | (
            domain.action_act == domain.act["closing"]
        )
        self._has_no_slot, self._is_empty = ~has_slot, ~has_slot & ~self._is_end
        self._can_answer = torch.zeros(domain.n_slots, dtype=torch.bool)
        self._can_answer[self._slot[self._is_answer]] = True

    def allowed(
        self, state: TensorDictBase, legal: torch.Tensor
    ) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Returns the actions that all rules allow, and those that each rule left out.

        Args:
            state: the state of the simulator or of a
                :class:`~bbq_torchrl.people.dialogue.tracking.Tracking`.
            legal: bool ``[*B, A]``.

        Returns:
            bool ``[*B, A]``, and for each rule bool ``[*B, A]``, the actions that it left out.
        """
        left_out = {}
        for name in self.rules:
            if name in _ALLOWED:
                kept = legal & _ALLOWED[name](self, state)
                kept = torch.where(kept.any(-1, keepdim=True), kept, legal)
                left_out[name] = legal & ~kept
                legal = kept
        return legal, left_out

    def remember(self, state: TensorDictBase) -> TensorDictBase:
        """Returns the state after a person's act, with only the values that records can meet.

        Values that the agent told are dropped if without them a record is nearer to what the person
        tells or asks for. The agent tells them again as if the person had just asked. A "no match"
        is always dropped. Wishes that no record contradicts, but that all records with the other
        wishes lack, are set aside: a single one, or any number for minor slots.

        The state gets the keys ``wished``, long ``[*B, S]``, the number of times that the person
        has told each slot, and ``aside``, long ``[*B, S]``, the values set aside.

        Args:
            state: the state of the simulator or of a
                :class:`~bbq_torchrl.people.dialogue.tracking.Tracking`.
        """
        held, tells = state["held"], state["user_informs"] != NONE
        aside = state.get("aside", torch.zeros_like(held))
        held = torch.where((aside != NONE) & ~tells, aside, held)
        if "take_back" in self.rules:
            wished = state.get("wished", torch.zeros_like(held)) + tells
            # Who does not care which movie does not wish the one that the agent picks.
            wished = torch.where(state["user_informs"] == DONT_CARE, 0, wished)
            own = wished == 0
            held = torch.where(own & (held == NO_MATCH), NONE, held)
            wishes = torch.where(own, NONE, held)
            is_nearer = self.records.best(wishes)[2] < self.records.best(held)[2]
            misses = self._open(state) & (self.records.having(held) == 0)
            is_found_without = self.records.having(wishes) > 0
            is_stuck = (is_nearer & tells.any(-1)) | (misses & is_found_without).any(-1)
            dropped = own & (held != NONE) & (held != DONT_CARE) & is_stuck[..., None]
            held = torch.where(dropped, NONE, held)
            state = state.replace(
                heard_requests=state["heard_requests"] | dropped,
                open_requests=state["open_requests"] | dropped,
                wished=wished,
            )
        if "on_file" in self.rules:
            differs, lacks, _ = self.records.best(held)
            is_single = lacks.sum(-1, keepdim=True) == 1
            is_detail = ~(lacks & ~self.records.minor).any(-1, keepdim=True)
            is_aside = lacks & ~differs.any(-1, keepdim=True) & (is_single | is_detail)
            state = state.replace(aside=torch.where(is_aside, held, NONE))
            held = torch.where(is_aside, DONT_CARE, held)
        return state.replace(held=held)

    def answers(self, state: TensorDictBase, legal: torch.Tensor) -> torch.Tensor:
        """Returns the action that answers an open question of the person, bool ``[*B, A]``.

        If several questions are open, it is the one that the fewest matching records can answer:
        the records with its answer can answer the others.
        """
        open_ = self._open(state)
        if "answers_first" not in self.rules:
            return torch.zeros_like(legal)
        having, n_records = self.records.having(state["held"]), len(self.records.has)
        rank = torch.where(having > 0, having, n_records + 1)
        rank = torch.where(open_, rank, n_records + 2)
        first = one_hot(rank.argmin(-1), rank.shape[-1]) & open_
        return legal & self._is_answer & first[..., self._slot]

    def continues(self, legal: torch.Tensor) -> torch.Tensor:
        """Returns the actions that may follow an answer in the same reply, bool ``[*B, A]``."""
        return legal & (self._is_request | self._is_booking)

    def is_stuck(
        self, state: TensorDictBase, refused: Iterable[Sequence[tuple[int, int]]] = ()
    ) -> bool:
        """Returns whether no record that is not refused has all values held in one dialogue."""
        differs, lacks = self.records.compare(state["held"])
        misses = (differs | lacks).any(-1) | self.records.with_any(refused)
        return bool(misses.all())

    def _open(self, state: TensorDictBase) -> torch.Tensor:
        """Returns the questions of the user that the agent can answer, bool ``[*B, S]``."""
        return (state["heard_requests"] | state["open_requests"]) & self._can_answer

    def _yes_ends(self, state: TensorDictBase) -> torch.Tensor:
        is_yes = state["heard_act"] == self._acts["thanks"]
        is_offer = state.get("offered", state["agent_informs"][..., self._complete] == AVAILABLE)
        ends = is_yes & is_offer & ~self._open(state).any(-1)
        return ends[..., None] == self._is_end

    def _answers_first(self, state: TensorDictBase) -> torch.Tensor:
        answers = self.answers(state, torch.ones_like(self._is_answer))
        return ~answers.any(-1, keepdim=True) | answers

    def _no_asking_back(self, state: TensorDictBase) -> torch.Tensor:
        known = self._open(state) | (state["held"] != NONE) | self.records.minor
        return ~(self._is_request & known[..., self._slot])

    def _implied(self, state: TensorDictBase) -> torch.Tensor:
        known = (state["held"] >= FIRST_VALUE)[..., None]
        is_implied = (known & self.records.determines).any(-2)
        return ~(self._is_request & is_implied[..., self._slot])

    def _news(self, state: TensorDictBase) -> torch.Tensor:
        is_refused = state["heard_act"] == self._acts["deny"]
        may_tell = self._open(state)[..., self._slot] | is_refused[..., None]
        is_known = (state["held"] != NONE) & ~self._open(state)
        is_idle = ~may_tell | is_known[..., self._slot]
        return ~((self._is_told & is_idle) | self._is_empty)

    def _no_repeat(self, state: TensorDictBase) -> torch.Tensor:
        told, asked = state["agent_informs"] != NONE, state["agent_requests"]
        offers = told[..., self._complete, None]
        is_last = (self._act == state["agent_act"][..., None]) & (
            self._has_no_slot
            | (self._is_request & asked[..., self._slot])
            | (self._is_booking & offers)
            | (~self._is_booking & ~offers & told[..., self._slot])
        )
        last = is_last.to(torch.uint8).argmax(-1)
        again = self._tracker.complete(state["held"], last)
        is_same = (again.informs == state["agent_informs"]) & (again.requests == asked)
        return ~(is_last & is_same.all(-1, keepdim=True))


_ALLOWED: dict[str, Callable[[Control, TensorDictBase], torch.Tensor]] = {
    "yes_ends": Control._yes_ends,
    "answers_first": Control._answers_first,
    "no_asking_back": Control._no_asking_back,
    "implied": Control._implied,
    "news": Control._news,
    "no_repeat": Control._no_repeat,
}
"""The actions that a rule allows in a state, bool ``[*B, A]``."""

IN_THE_SIMULATOR = (*_ALLOWED, "take_back", "on_file")
"""The rules that concern acts and memory; the others concern sentences alone."""
