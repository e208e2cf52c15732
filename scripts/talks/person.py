"""A person with a goal card, who reads what an agent says and answers in free text."""

from __future__ import annotations

import random
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.domains.frames import ANY
from bbq_torchrl.domains.values import RESERVED_TEXT
from bbq_torchrl.people.language.quantities import UNITS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bbq_torchrl.domains import Domain, Goal
    from bbq_torchrl.people.dialogue.exchange import Answer

PEOPLE: dict[str, Any] = yaml.safe_load(
    Path(__file__).with_name("people.yaml").read_text(encoding="utf-8")
)
_RESERVED = frozenset(RESERVED_TEXT.values())
_PATIENCE = 3  # replies without progress after which a person leaves
_UNPREPARED = re.compile(r"\b(on|at|for) (?=(tonight|tomorrow|this|next|any|after|late|early)\b)")
_ONE = {"1 tickets": "1 ticket", "1 people": "1 person", "1 seats": "1 seat", "1 tix": "1 ticket"}


def suits(kind: str, goal: Goal) -> bool:
    """Returns whether a goal has what the habits of a kind need."""
    entry = PEOPLE["kinds"][kind]
    told, lacks = goal.constraints.keys(), set(entry.get("lacks", ()))
    enough = len(goal.requests) >= entry.get("questions", 0)
    return (
        set(entry.get("needs", ())) <= told and lacks.isdisjoint(told | {*goal.requests}) and enough
    )


@dataclass(frozen=True)
class Said:
    """One text of a person, and its meaning.

    Attributes:
        text: as typed.
        informs: the values meant.
        requests: the slots asked for.
        act: "", "yes", "no", "any", "book", "bye" or "nothing".
        never: a value that the text excludes, by slot.
        unknown: the slot of a name that the domain lacks.
    """

    text: str
    informs: dict[str, str] = field(default_factory=dict)
    requests: tuple[str, ...] = ()
    act: str = ""
    never: dict[str, str] = field(default_factory=dict)
    unknown: str = ""


class Person:
    """A person of one kind.

    Args:
        kind: one of the kinds of ``people.yaml``.
        goal: what the person is to get.
        domain: values of other records are those that the person names by mistake.
        seed: of all choices.
        labels: how people call the slots.
    """

    def __init__(
        self, kind: str, goal: Goal, domain: Domain, seed: int, labels: Mapping[str, str]
    ) -> None:
        self._kind, self._goal, self._domain = PEOPLE["kinds"][kind], goal, domain
        self._hand = PEOPLE["hands"][self._kind["hand"]]
        self._labels = labels
        self._random = random.Random(f"{kind}/{seed}")
        self._untold = list(goal.constraints)
        self._answers: dict[str, str] = {}
        self._says = list(self._kind.get("says", ()))
        self._turn = self._worries = 0
        self._other: dict[str, str] = {}
        self.last = Said("")
        self._held: Mapping[str, str] = {}

    def say(self, answer: Answer | None, held: Mapping[str, str]) -> Said:
        """Returns the next text; after one with act "bye" the person is gone.

        Args:
            answer: of the agent; ``None`` at the start.
            held: the values that the agent has; of them, the person is shown those that it checks.
        """
        self._held = held
        said = self._planned(answer) or (self._open() if answer is None else self._reply(answer))
        for slot in said.informs:
            if slot in self._untold and not said.never:
                self._untold.remove(slot)
        self._turn += 1
        self.last = said
        return _voiced(said, self._kind.get("voice", ""), self._random)

    @property
    def missing(self) -> list[str]:
        """The questions of the card that are not answered."""
        return [slot for slot in self._goal.requests if slot not in self._answers]

    def hears(self, answer: Answer) -> None:
        """Takes down what the agent tells."""
        if answer.answered.act in ("inform", "request"):
            told = {k: v for k, v in answer.answered.informs.items() if v not in _RESERVED}
            self._answers |= {k: v for k, v in told.items() if k not in self._goal.constraints}

    def _open(self) -> Said:
        order = [slot for slot in _ORDER if slot in self._untold]
        rest = [slot for slot in self._untold if slot not in _ORDER]
        count = self._kind["open"]
        chosen = (order + rest)[: None if count == "all" else max(count, 1)]
        pieces = self._hand["piece"]
        parts = [pieces.get(slot, pieces["rest"]).format(self._written(slot)) for slot in chosen]
        lead = self._choose(self._hand["lead"])
        text = self._hand["join"].join(filter(None, (lead, *parts))).replace(" ,", ",")
        informs = {slot: self._goal.constraints[slot] for slot in chosen}
        requests = ()
        if self._kind["asks"] == "first" and self.missing:
            requests = (self.missing[0],)
            text = f"{text}. {self._question(requests[0])}"
        return Said(text, informs, requests)

    def _planned(self, answer: Answer | None) -> Said | None:
        """Returns the habit that is due now, if any."""
        for plan in self._says:
            at = plan["at"]
            is_request = answer is not None and answer.answered.act == "request"
            is_due = (
                at == self._turn
                or (at == "request" and is_request)
                or (at == "answer" and bool(self._answers))
            )
            is_any_time = at == "answer" or plan["means"] == "drop"
            is_offer = answer is not None and self._is_offer(answer)
            if not is_due or (is_offer and not is_any_time):
                continue
            self._says.remove(plan)
            return self._habit(plan)
        return None

    def _habit(self, plan: dict[str, Any]) -> Said | None:
        means, slot = plan["means"], plan.get("of", "")
        if means == "book":
            return Said(self._choose(self._hand["book"]), act="book")
        if means == "again":
            slot = next(iter(self._answers))
            return Said(f"sorry, once more: {self._question(slot)}", requests=(slot,))
        if means == "nothing":
            return Said(self._choose(plan["say"]), act="nothing")
        if means == "drop":
            return Said(self._choose(plan["say"]), {slot: ANY})
        own = self._goal.constraints.get(slot, "")
        other = self._choose(PEOPLE["unknown"]) if means == "unknown" else self._another(slot)
        text = self._choose(plan["say"]).format(other=other, own=own)
        if means == "unknown":
            return Said(text, unknown=slot)
        if plan.get("never"):
            return Said(text, never={slot: other})
        return Said(text, {slot: own if means == "back" else other})

    def _another(self, slot: str) -> str:
        """Returns a plain value of a slot that is not the goal's."""
        own = self._goal.constraints.get(slot)
        plain = _PLAIN.get(slot)
        found = plain or sorted({row[slot] for row in self._domain.records if slot in row})
        return self._choose([value for value in found if value != own])

    def _reply(self, answer: Answer) -> Said:
        self.hears(answer)
        if answer.answered.act == "not_sure":
            said = self._to_check(answer)
        elif self._is_offer(answer):
            said = self._to_offer(answer)
        elif answer.answered.requests:
            said = self._to_question(answer)
        else:
            said = self._to_telling(answer)
        is_stuck = not said.requests and said.act != "yes" and not self._brings_news(said)
        self._worries = self._worries + 1 if is_stuck or said.text == self.last.text else 0
        if self._worries > _PATIENCE:
            return Said(self._choose(self._hand["bye"]), act="bye")
        return said

    def _brings_news(self, said: Said) -> bool:
        return any(slot in self._untold for slot in said.informs)

    def _is_offer(self, answer: Answer) -> bool:
        return self._domain.complete_slot in answer.answered.informs

    def _to_check(self, answer: Answer) -> Said:
        """Answers "..., is that right?", "shall I take that?" and "say it another way"."""
        wishes = dict(answer.answered.informs)
        if not wishes:
            return self._again()
        # A showing that is proposed may have any value of what the goal leaves open.
        known = {**answer.memory.proposal, **self._answers, **self._goal.constraints}
        wrong = [
            slot
            for slot, value in wishes.items()
            if value not in (known.get(slot), self.last.informs.get(slot))
        ]
        if not wrong:
            return Said(self._choose(self._hand["yes"]), wishes, act="yes")
        fixed = [slot for slot in wrong if slot in self._goal.constraints]
        return (
            self._tell(fixed[:1], "fix")
            if fixed
            else Said(self._choose(self._hand["no"]), act="no")
        )

    def _again(self) -> Said:
        """Says the last once more, in other words."""
        last = self.last
        if last.requests:
            return Said(self._question(last.requests[0]), requests=last.requests[:1])
        if last.informs and not last.never:
            return self._tell([slot for slot in last.informs if slot in self._goal.constraints][:2])
        return self._next()

    def _to_offer(self, answer: Answer) -> Said:
        told = answer.answered.informs
        goal = self._goal.constraints
        wrong = [slot for slot, value in goal.items() if told.get(slot) != value]
        is_free = told[self._domain.complete_slot] not in _RESERVED or "available" in str(
            told[self._domain.complete_slot]
        )
        if wrong:
            untold = [slot for slot in wrong if slot in self._untold]
            return self._tell((untold or wrong)[:2], "" if untold else "fix")
        if not is_free:
            return self._tell(list(goal)[:3])
        if self.missing:
            return self._ask(self.missing[0])
        return Said(self._choose(self._hand["yes"]), act="yes")

    def _to_question(self, answer: Answer) -> Said:
        asked = answer.answered.requests[0]
        if (
            self._kind["asks"] == "back"
            and self.missing
            and self.last.requests != (self.missing[0],)
        ):
            return self._ask(self.missing[0])
        if answer.answered.choices:
            own = self._goal.constraints.get(asked)
            return self._tell([asked]) if own else Said(self._choose(self._hand["any"]), act="any")
        if asked in self._goal.constraints:
            return self._tell([asked, *self._more(asked)])
        if asked in self._goal.requests and asked not in self._answers:
            return self._ask(asked)
        return Said(self._choose(self._hand["any"]), act="any")

    def _to_telling(self, answer: Answer) -> Said:
        told = answer.answered.informs
        if "no match" in told.values():  # the sentence names what does not go together
            goal = self._goal.constraints
            wrong = [
                k for k, v in self._held.items() if k in goal and v not in (goal[k], "no match")
            ]
            if wrong:
                return self._tell(wrong[:2], "fix")
            known = {**goal, **self._answers}
            foreign = [k for k, v in self._held.items() if k not in known and v not in _RESERVED]
            if foreign:
                name = self._labels.get(foreign[0], foreign[0])
                return Said(f"Any {name} is fine", {foreign[0]: ANY})
        for slot, value in told.items():
            if slot in self._goal.constraints and value != self._goal.constraints[slot]:
                return self._tell([slot], "fix")
        return self._next()

    def _next(self) -> Said:
        if self.missing and self._kind["asks"] != "late":
            return self._ask(self.missing[0])
        if self._untold:
            return self._tell(self._untold[:1])
        return Said(self._choose(self._hand["book"]), act="book")

    def _more(self, asked: str) -> list[str]:
        return [slot for slot in self._untold if slot != asked][: self._kind.get("more", 0)]

    def _ask(self, slot: str) -> Said:
        if self._kind["asks"] == "two" and len(self.missing) > 1:
            first, second = self.missing[:2]
            one, other = (self._question(name) for name in (first, second))
            other = other[0].lower() + other[1:]
            return Said(f"{one.rstrip('?')}, and {other}", requests=(first, second))
        return Said(self._question(slot), requests=(slot,))

    def _question(self, slot: str) -> str:
        return self._choose(self._hand["ask"].get(slot) or [f"What is the {slot}?"])

    def _tell(self, slots: list[str], how: str = "") -> Said:
        if not slots:
            return self._next()
        alone = self._hand["alone"]
        values = self._goal.constraints
        texts = [self._choose(alone.get(s, alone["rest"])).format(self._written(s)) for s in slots]
        text = ". ".join(texts)
        if how:
            text = self._choose(self._hand[how]).format(text)
        return Said(text, {slot: values[slot] for slot in slots})

    def _written(self, slot: str) -> str:
        """Returns a value of the card as a person writes it: a state that is a word in full."""
        value = self._goal.constraints[slot]
        return _STATES.get(value, value) if slot == "state" else value

    def _choose(self, options: list[str]) -> str:
        return self._random.choice(options)


_STATES = {"ok": "Oklahoma", "in": "Indiana", "me": "Maine", "or": "Oregon", "hi": "Hawaii"}
_ORDER = ("numberofpeople", "moviename", "genre", "theater", "city", "state", "date", "starttime")
_PLAIN = {
    "date": ["friday", "monday", "saturday", "tomorrow", "sunday"],
    "starttime": ["5 pm", "7 pm", "6:30 pm", "2 pm"],
}


def _voiced(said: Said, voice: str, chance: random.Random) -> Said:
    """Returns a text as this voice types it."""
    text = _UNPREPARED.sub("", said.text)
    for many, one in _ONE.items():
        text = text.replace(many, one)
    if voice == "typos":
        text = " ".join(_slipped(word, chance) for word in text.split(" "))
    elif voice == "capitals":
        text = text.upper() if chance.random() < 0.5 else text.lower()
    elif voice == "dictated":
        text = _dictated(text)
    return Said(text, said.informs, said.requests, said.act, said.never, said.unknown)


def _slipped(word: str, chance: random.Random) -> str:
    """Returns a word, one in four of the long ones with two letters swapped, or one left out."""
    if len(word) < 5 or not word.isalpha() or chance.random() > 0.25:
        return word
    at = chance.randrange(1, len(word) - 2)
    if chance.random() < 0.5:
        return word[:at] + word[at + 1] + word[at] + word[at + 2 :]
    return word[:at] + word[at + 1 :]


def _dictated(text: str) -> str:
    """Returns a text without marks and capitals, its small numbers in words."""

    def spelled(found: re.Match[str]) -> str:
        number = int(found[0])
        return UNITS[number] if number < len(UNITS) else found[0]

    text = re.sub(r"(\d+):(\d\d)", lambda found: f"{found[1]} {found[2]}", text.lower())
    text = re.sub(r"\b\d+\b", spelled, text)
    return " ".join(re.sub(r"[^\w\s'&]", " ", text).split())
