"""The agenda-based user. Each rule counts its applications in `fired`, which tests check."""

import math
from types import MappingProxyType

from .draws import choose_index, choose_slot
from .values import AVAILABLE, DONT_CARE, NO_MATCH, plain


class User:
    """A user with a goal, which it reveals step by step.

    `act`, `informs` and `pending` (its requests) are its last act. `informs` has the values meant
    until errors are applied, then the values transmitted.
    """

    leaves_after = math.inf
    error_prob = MappingProxyType({})

    def __init__(self, world, goal, draws):
        self.constraints = {
            slot: plain(value) for slot, value in goal.constraints.items() if slot in world.active
        }
        self.requests = {slot for slot in goal.requests if slot in world.active} | {world.ticket}
        self.slots, self.fired = world.slots, world.fired
        self.ticket, self.complete = world.ticket, world.complete
        self.history = {}
        self.constraints_met = False
        self.agenda = set(self.constraints) | self.requests
        self.pending = set()
        self.informs = {}
        self.act = "request"
        self._open(world.domain.opening_slots, draws)

    def _open(self, opening, draws):
        for slot in opening:
            if slot in self.constraints:
                self.fired["open: the opening slot"] += 1
                self._inform(slot)
        if self.constraints:
            self._inform(choose_slot(self.constraints, draws["constraint"], self.slots))
        else:
            self.fired["open: no constraint"] += 1
        others = self.requests - {self.ticket}
        if others:
            self.fired["open: a request"] += 1
            self.pending = {choose_slot(others, draws["request"], self.slots)}
        else:
            self.fired["open: ticket"] += 1
            self.pending = {self.ticket}

    def remember_last_act(self):
        """Moves the values transmitted last time to the history."""
        self.history.update(self.informs)
        self.informs = {}

    def reply(self, kind, act, slot, filled, offered, draws):
        """Answers an agent act that does not end the dialogue."""
        if kind == "request":
            self._answer_request(slot)
        elif kind == "inform" and slot == self.complete:
            self._judge_offer(filled)
        elif kind == "inform":
            self._take_inform(slot, filled[slot], draws)
        elif kind == "multiple_choice":
            self._choose(slot, offered, draws)
        elif act == "confirm_answer":
            self._go_on_from_agenda(draws)
        else:
            self.fired[f"repeat: {act}"] += 1

    # Elementary operations on a slot.
    def _inform(self, slot):
        self.informs[slot] = self.constraints[slot]
        self.agenda.discard(slot)

    def _request(self, slot):
        self.pending.add(slot)
        self.act = "request"

    def _open_constraints(self):
        return [slot for slot in self.slots if slot in self.agenda and slot in self.constraints]

    # The replies to the agent's acts.
    def _answer_request(self, slot):
        if slot in self.constraints:
            self.fired["request: a constraint"] += 1
            self._inform(slot)
            self.pending = set()
            self.act = "inform"
        elif slot in self.requests and slot not in self.agenda and slot in self.history:
            self.fired["request: an answered request"] += 1
            self.informs[slot] = self.history[slot]
            self.pending = set()
            self.act = "inform"
        elif slot in self.requests and slot in self.agenda:
            self.fired["request: an open request"] += 1
            for constraint in self._open_constraints():
                self.fired["request: an open request, with constraints"] += 1
                self._inform(constraint)
            self._request(slot)
        else:
            self.informs[slot] = DONT_CARE
            if self.pending or self.agenda:
                self.fired["request: of no interest"] += 1
                self.act = "inform"
            else:
                self.fired["request: of no interest, nothing left"] += 1
                self.act = "thanks"

    def _take_inform(self, slot, value, draws):
        self.history[slot] = value
        if slot not in self.constraints:
            self.fired["inform: no constraint"] += 1
            if slot == self.ticket:
                self.fired[f"inform: ticket, {value}"] += 1
            self.agenda.discard(slot)
            self.pending.discard(slot)
            self._continue("B", draws)
        elif value == self.constraints[slot]:
            self.fired["inform: right"] += 1
            self.agenda.discard(slot)
            self._continue("A", draws)
        else:
            self.fired["inform: wrong"] += 1
            self._inform(slot)
            self.act = "inform"

    def _continue(self, way, draws):
        others = self.agenda - {self.ticket}
        if self.pending:
            self.fired[f"{way}: a pending request"] += 1
            self.act = "request"
        elif others:
            slot = choose_slot(others, draws["agenda"], self.slots)
            if slot not in self.constraints:
                self.fired[f"{way}: a request of the agenda"] += 1
                self._request(slot)
            else:
                self._inform(slot)
                if way == "B" and self.ticket in self.agenda:
                    self.fired["B: a constraint with the ticket"] += 1
                    self._request(self.ticket)
                else:
                    self.fired[f"{way}: a constraint"] += 1
                    self.act = "inform"
        elif self.ticket in self.agenda:
            self.fired[f"{way}: the ticket"] += 1
            self._request(self.ticket)
        else:
            self.fired[f"{way}: thanks"] += 1
            self.act = "thanks"

    def _judge_offer(self, filled):
        wrong = [slot for slot, value in self.constraints.items() if filled.get(slot) != value]
        available = filled[self.complete] == AVAILABLE
        verdict = "deny" if wrong else "thanks"
        self.fired[f"offer: {verdict}, {'' if available else 'not '}available"] += 1
        self.act = verdict
        self.constraints_met = not wrong
        if wrong:
            self.pending = set()
        if not available:
            self.history[self.ticket] = NO_MATCH
            self.agenda.discard(self.ticket)
            self.pending.discard(self.ticket)

    def _go_on_from_agenda(self, draws):
        if not self.agenda:
            self.fired["confirm_answer: thanks"] += 1
            self.act = "thanks"
            return
        slot = choose_slot(self.agenda, draws["agenda"], self.slots)
        if slot in self.requests:
            what = "the ticket" if slot == self.ticket else "a request"
            self.fired[f"confirm_answer: {what}"] += 1
            self._request(slot)
        else:
            self.fired["confirm_answer: a constraint"] += 1
            self._inform(slot)
            self.act = "inform"

    def _choose(self, slot, offered, draws):
        self.act = "inform"
        if slot in self.constraints:
            self.fired["choice: a constraint"] += 1
            self._inform(slot)
        elif offered:
            self.fired["choice: one of those offered"] += 1
            self.informs[slot] = list(offered)[choose_index(draws["offer"], len(offered))]
        else:
            self.fired["choice: nothing offered"] += 1
            self.informs[slot] = DONT_CARE

    def close(self):
        """Ends the dialogue; pending requests stay visible."""
        self.act = "closing"
        self.informs = {}

    def faults(self):
        """Returns the reasons why the dialogue has not succeeded; empty on success."""
        broken = [
            slot
            for slot, value in self.constraints.items()
            if slot in self.history and self.history[slot] != value
        ]
        faults = {
            "constraints not met": not self.constraints_met,
            "a pending request": bool(self.pending - {self.ticket}),
            "an agenda": bool(self.agenda - {self.ticket}),
            "no match in history": NO_MATCH in self.history.values(),
            "a wrong value in history": bool(broken),
        }
        return [name for name, is_so in faults.items() if is_so]
