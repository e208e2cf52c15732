"""One conversation of a person with an agent, and its counts."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from bbq_torchrl.domains.values import RESERVED_TEXT

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bbq_torchrl.people.dialogue.exchange import Answer
    from bbq_torchrl.people.dialogue.partner import Partner
    from talks.person import Person, Said

_MAX_TEXTS = 25
_RESERVED = frozenset(RESERVED_TEXT.values())
_FAULTS = ("dropped", "wrong", "repeated", "turned_round", "cut_off")


class Talk:
    """One conversation, and its counts.

    - texts: of the person
    - values: told, and dropped: of them neither held nor asked about after the reply
    - acted: replies by an act, and wrong: of them on a value or question that was not meant, or not
      on a question that was
    - questions: of the person, and answered: of them in the next reply; late: the same after an
      offer
    - asked: questions of the agent, and repeated: of them asked before, though nothing new was told
      since, or the answer was
    - yes: to an offer, and yes_ends: of them the conversation ended
    - never: values excluded, and turned_round: of them held afterwards
    - unknown: names that the domain lacks, and reported: of them told or asked about
    - cut_off: ended by the agent without a yes or a farewell
    """

    def __init__(self, partner: Partner, person: Person) -> None:
        self.lines: list[str] = []
        self.said: list[tuple[Said, Answer]] = []
        self.counts: Counter[str] = Counter()
        self.ended = ""
        self._partner, self._person = partner, person
        self._asked: dict[str, int] = {}
        self._told: dict[str, tuple[str, int]] = {}
        self._news = -1

    def play(self, seed: int) -> None:
        """Talks until somebody ends it."""
        answer: Answer | None = None
        for turn in range(_MAX_TEXTS):
            said = self._person.say(answer, self._held(answer))
            memory = None if answer is None else answer.memory
            now = self._partner.reply(memory, said.text, seed * 1000 + turn)
            earlier = self.counts.copy()
            self._count(turn, said, answer, now)
            self.said.append((said, now))
            new = self.counts - earlier
            faults = [name for name in _FAULTS if new[name]]
            faults += ["unanswered"] * (new["answered"] < new["questions"])
            note = f"heard {now.understood}" if now.acted else "asks"
            marks = "".join(f" !{name}" for name in faults)
            self.lines += [f"  person: {said.text}", f"  agent:  {now.text}  [{note}]{marks}"]
            answer, self.ended = now, now.ended
            if self.ended or said.act == "bye":
                break
        if answer is not None:
            self._person.hears(answer)
        self.ended = self.ended or "left"

    def _held(self, answer: Answer | None) -> Mapping[str, str]:
        if answer is None or answer.memory.state is None:
            return {}
        return self._partner._tracking.kept(answer.memory.state)

    def _count(self, turn: int, said: Said, before: Answer | None, now: Answer) -> None:
        count = self.counts
        count["texts"] += 1
        held, act = self._held(now), now.answered
        waiting = now.memory.asking.waiting
        kept = {**held, **(waiting.informs if waiting else {})}
        asked = {*act.requests, *(act.informs if act.act == "not_sure" else ())}
        is_vague = act.act == "not_sure" and not act.informs
        complete = self._partner.domain.complete_slot
        for slot, value in said.informs.items():
            count["values"] += 1
            is_lost = kept.get(slot) != value and slot not in asked and not is_vague
            count["dropped"] += is_lost and now.ended != "agent"
            if self._told.get(slot, ("",))[0] != value:
                self._news = turn
            self._told[slot] = (value, turn)
        if now.acted:
            count["acted"] += 1
            heard = {k: v for k, v in now.understood.informs.items() if v not in _RESERVED}
            proposed = {} if before is None else before.memory.proposal
            if said.informs.items() & proposed.items():  # who names one of its values takes it all
                heard = dict(heard.items() - proposed.items())
            is_foreign = any(said.informs.get(k, self._earlier(k)) != v for k, v in heard.items())
            questions = set(now.understood.requests) - {self._partner.domain.ticket_slot}
            is_other = bool(questions - set(said.requests)) or not set(said.requests) <= questions
            count["wrong"] += is_foreign or is_other
        was_offered = any(complete in answer.answered.informs for _, answer in self.said)
        for slot in said.requests:
            is_answered = act.informs.get(slot, "no match") not in _RESERVED
            is_heard = slot in now.understood.requests
            is_answered |= bool(act.choices) and is_heard  # a list of them, or of their cities
            count["questions"] += 1
            count["answered"] += is_answered
            count["late_questions"] += was_offered
            count["late_answered"] += was_offered and is_answered
            self._news = turn
        self._count_question(turn, said, now)
        is_offered = before is not None and complete in before.answered.informs
        if said.act == "yes" and is_offered:
            count["yes"] += 1
            count["yes_ends"] += now.ended == "agent"
        for slot, value in said.never.items():
            count["never"] += 1
            count["turned_round"] += held.get(slot) == value
            self._news = turn
        if said.unknown:
            count["unknown"] += 1
            is_told = not now.acted or said.unknown in act.requests
            count["reported"] += is_told and said.unknown not in held
        is_end = now.ended in ("agent", "person")
        wants_end = said.act in ("yes", "bye", "book")
        count["cut_off"] += is_end and not wants_end

    def _count_question(self, turn: int, said: Said, now: Answer) -> None:
        """Counts a question of the agent's, and whether it was asked before in vain."""
        act = now.answered
        if not (act.requests or act.act == "not_sure"):
            return
        slots = [*act.requests, *act.informs]
        key = f"{act.act} {' '.join(slots)}"
        since = self._asked.get(key)
        self._asked[key] = turn
        self.counts["asked"] += 1
        if since is None or said.act == "nothing":
            return
        has_answer = any(self._told.get(slot, ("", -1))[1] > since for slot in slots)
        self.counts["repeated"] += self._news <= since or has_answer

    def _earlier(self, slot: str) -> str:
        """Returns the value that the person told before: a reply may join it."""
        return self._told.get(slot, ("", 0))[0]
