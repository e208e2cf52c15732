"""Sentences to learn from: frames of every kind, said by the domain's grammar."""

from __future__ import annotations

import random
import re
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

from bbq_torchrl.domains.frames import ANY, AVAILABLE_TEXT, NO_MATCH_TEXT, Frame
from bbq_torchrl.language.compose import Composer
from bbq_torchrl.language.noise import as_second_language, slangy, with_typos
from bbq_torchrl.language.simulated import play
from bbq_torchrl.language.surfaces import Surfaces
from bbq_torchrl.language.tagger import OUTSIDE
from bbq_torchrl.language.words import tokenize

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.language.lexicon import Lexicon
    from bbq_torchrl.language.templates import Piece

__all__ = ["Example", "make_examples", "spoiled", "tag"]

_SLOTLESS = tuple(
    "greeting thanks deny confirm_answer not_sure closing welcome request inform confirm_question "
    "multiple_choice".split()
)
_SMALL_WORDS = frozenset(("in", "or", "ok", "hi", "me", "oh"))
_DIALOGUES = 1_000
_KEPT = 100  # of 500


@dataclass(frozen=True)
class Example:
    """A sentence with what it means.

    Attributes:
        words: as :func:`~bbq_torchrl.language.words.tokenize` makes them.
        tags: the slot whose value each word is part of, else :data:`OUTSIDE`.
        frame: what is meant.
        question: the agent's last act; ``None`` at the opening.
    """

    words: list[str]
    tags: list[str]
    frame: Frame
    question: Frame | None


def tag(pieces: Sequence[Piece]) -> tuple[list[str], list[str]]:
    """Returns the words of pieces and their tags."""
    words: list[str] = []
    tags: list[str] = []
    for slot, together in groupby(pieces, key=lambda piece: piece.slot):
        own = tokenize("".join(piece.text for piece in together))
        words += own
        tags += [OUTSIDE if slot is None else slot] * len(own)
    return words, tags


def make_examples(
    lexicon: Lexicon,
    count: int,
    seed: int,
    *,
    noise: float = 1.0,
    simulated: bool = False,
) -> list[Example]:
    """Returns sentences of the domain's own grammar.

    Args:
        lexicon: the domain's phrases and values.
        count: how many.
        seed: chooses all.
        noise: scales how often sentences are spoiled.
        simulated: whether the acts are those of simulated users, who ask several things at once.
    """
    rng = random.Random(seed)
    # Other dialogues than those that the round trip is measured on.
    other = seed + 1_000_000
    turns = play(lexicon.domain, _DIALOGUES, seed=other, kept=_KEPT) if simulated else []
    frames = _Frames(lexicon)
    composer = Composer(lexicon, simulated=simulated)
    surfaces = Surfaces(lexicon)
    examples: list[Example] = []
    while len(examples) < count:
        question, frame = rng.choice(turns) if simulated else frames.draw(rng)
        is_clear = simulated and rng.random() < 0.5
        words, tags = tag(composer.compose(frame, question, rng, surfaces, is_clear=is_clear))
        words, tags = _spoil(words, tags, rng, noise)
        if words and len(words) <= 60:
            examples.append(Example(words, tags, frame, question))
    return examples


def spoiled(examples: Sequence[Example], seed: int) -> list[Example]:
    """Returns sentences of people spoiled as those of the grammar are."""
    rng = random.Random(seed)
    found = []
    for example in examples:
        words, tags = _spoil(example.words, example.tags, rng, 1.0)
        found.append(replace(example, words=words, tags=tags))
    return found


def _spoil(
    words: list[str], tags: list[str], rng: random.Random, noise: float
) -> tuple[list[str], list[str]]:
    if rng.random() < 0.5 * noise:
        kept = [
            (w, t)
            for w, t in zip(words, tags, strict=True)
            if t != OUTSIDE or w.isalnum() or "'" in w or rng.random() < 0.15
        ]
        words, tags = [word for word, _ in kept], [tag for _, tag in kept]
    if rng.random() < 0.3 * noise:
        words, tags = as_second_language(words, tags, rng)
    if rng.random() < 0.15 * noise:
        words, tags = slangy(words, tags, rng)
    if rng.random() < 0.35 * noise:
        words = with_typos(words, 0.12, rng)
    return words, tags


def _shapes(lexicon: Lexicon, slot: str) -> tuple[list[list[str]], list[float]]:
    """Returns the values of a slot by the shape of their keys, and how often to draw each."""
    shapes: dict[str, list[str]] = {}
    for value in lexicon.values(slot):
        key = lexicon.key(slot, value)
        is_read = lexicon.kinds[slot] != "text" and any(letter.isdigit() for letter in key)
        shapes.setdefault(re.sub(r"\d+", "0", key) if is_read else "", []).append(value)
    return list(shapes.values()), [len(values) ** 0.5 for values in shapes.values()]


def _drawn(
    weights: Mapping[str, float], rng: random.Random, count: int, but: Sequence[str]
) -> list[str]:
    """Returns slots drawn by their weights, one perhaps several times, but none of some.

    None at all where there are no others.
    """
    slots = [slot for slot in weights if slot not in but]
    return rng.choices(slots, [weights[slot] for slot in slots], k=count) if slots else []


class _Frames:
    """Draws what agents ask and users mean."""

    def __init__(self, lexicon: Lexicon) -> None:
        domain = lexicon.domain
        self._domain, self._lexicon = domain, lexicon
        self._slotless = [act for act in _SLOTLESS if act in domain.acts]
        goals = len(domain.goals)
        requested = [s for goal in domain.goals for s in goal.requests]
        told = [a.slot for a in domain.actions if a.kind == "inform" and a.slot]
        asked = [a.slot for a in domain.actions if a.kind == "request" and a.slot]
        constrained = [s for goal in domain.goals for s in goal.constraints]
        self._asked = [s for s in asked if s in lexicon.slots]
        self._told = [s for s in told if s in lexicon.slots]
        wanted = dict.fromkeys((*requested, *told, *asked))
        wanted.pop(domain.complete_slot, None)
        self._wanted = {slot: 1.0 + 3.0 * (requested.count(slot) / goals) ** 0.5 for slot in wanted}
        self._wanted[domain.ticket_slot] = 6.0
        self._valued = {
            slot: 0.35 + 2.0 * (constrained.count(slot) / goals) ** 0.5 for slot in lexicon.slots
        }
        self._wishes = {
            slot: [g.constraints[slot] for g in domain.goals if g.constraints.get(slot, ANY) != ANY]
            for slot in lexicon.slots
        }
        self._shapes = {slot: _shapes(lexicon, slot) for slot in lexicon.slots}

    def draw(self, rng: random.Random) -> tuple[Frame | None, Frame]:
        """Returns the agent's last act and what the user means."""
        kind = rng.random()
        if kind < 0.32:
            return None, self._opening(rng)
        if kind < 0.70 and self._asked:
            slot = rng.choices(self._asked, [self._valued[s] for s in self._asked])[0]
            return Frame("request", {}, (slot,)), self._answer(slot, rng)
        if kind < 0.83 and self._told:
            slot = rng.choice(self._told)
            value = NO_MATCH_TEXT if rng.random() < 0.2 else self._value(slot, rng)
            return Frame("inform", {slot: value}), self._reaction(slot, rng)
        if kind < 0.93:
            complete = self._domain.complete_slot
            verdict = rng.choice((AVAILABLE_TEXT, NO_MATCH_TEXT))
            question = Frame("inform", {complete: verdict, **self._values(rng, rng.randint(1, 4))})
            return question, self._verdict(question, rng)
        act = rng.choice(("greeting", "deny", "confirm_question", "confirm_answer"))
        if rng.random() < 0.3:
            ticket = Frame(
                "inform", {self._domain.ticket_slot: rng.choice((AVAILABLE_TEXT, NO_MATCH_TEXT))}
            )
            return ticket, self._reaction(None, rng)
        return Frame(act), self._after_act(act, rng)

    def _value(self, slot: str, rng: random.Random) -> str:
        """Returns a value; those of few kinds ("after work") as often as clocks of many."""
        if self._wishes.get(slot) and rng.random() < 0.35:
            return rng.choice(self._wishes[slot])
        shapes, weights = self._shapes[slot]
        value = rng.choice(rng.choices(shapes, weights)[0])
        return rng.choice(self._lexicon.values(slot)) if value in _SMALL_WORDS else value

    def _values(self, rng: random.Random, count: int, but: tuple[str, ...] = ()) -> dict[str, str]:
        slots = _drawn(self._valued, rng, count, but)
        return {slot: self._value(slot, rng) for slot in slots}

    def _requests(
        self, rng: random.Random, count: int, but: tuple[str, ...] = ()
    ) -> tuple[str, ...]:
        return tuple(dict.fromkeys(_drawn(self._wanted, rng, count, but)))

    def _slotless_act(self, rng: random.Random) -> Frame:
        return Frame(rng.choice(self._slotless))

    def _opening(self, rng: random.Random) -> Frame:
        kind = rng.random()
        count = rng.choices((0, 1, 2, 3, 4, 5), (2, 5, 6, 5, 3, 1))[0]
        if kind < 0.62:
            requests = self._requests(rng, rng.choices((1, 2, 3), (16, 3, 1))[0])
            return Frame("request", self._values(rng, count, requests), requests)
        if kind < 0.66:
            return Frame("confirm_question", self._values(rng, rng.randint(1, 3)))
        if kind < 0.9:
            return Frame("inform", self._values(rng, max(count, 1)))
        return Frame("greeting") if rng.random() < 0.5 else self._slotless_act(rng)

    def _answer(self, slot: str, rng: random.Random) -> Frame:
        kind = rng.random()
        value = {slot: self._value(slot, rng)}
        if kind < 0.36:
            return Frame("inform", value)
        if kind < 0.46:
            return Frame("inform", value | self._values(rng, 1, (slot,)))
        if kind < 0.56:
            return Frame("inform", value, self._requests(rng, 1, (slot,)))
        if kind < 0.67:
            return Frame("inform", {slot: ANY})
        if kind < 0.70:
            return Frame("inform", {slot: ANY}, self._requests(rng, 1, (slot,)))
        if kind < 0.72:
            return Frame("inform", {rng.choice(self._asked): ANY})
        if kind < 0.79:
            return Frame("inform", self._values(rng, rng.choice((1, 1, 2)), (slot,)))
        if kind < 0.88:
            asked = (
                (slot,) if rng.random() < 0.7 and slot in self._wanted else self._requests(rng, 1)
            )
            return Frame("request", self._values(rng, rng.choice((0, 0, 0, 1)), asked), asked)
        if kind < 0.93:
            return Frame("not_sure") if "not_sure" in self._slotless else self._slotless_act(rng)
        return self._slotless_act(rng)

    def _reaction(self, slot: str | None, rng: random.Random) -> Frame:
        kind = rng.random()
        if kind < 0.2 and slot is not None:
            return Frame(
                "inform",
                {slot: self._value(slot, rng)} | self._values(rng, rng.choice((0, 0, 1)), (slot,)),
            )
        if kind < 0.3:
            requests = self._requests(rng, rng.choice((0, 0, 1)))
            return Frame("inform", self._values(rng, 1, requests), requests)
        if kind < 0.62:
            requests = self._requests(rng, 1)
            return Frame("request", self._values(rng, rng.choice((0, 0, 0, 1)), requests), requests)
        if kind < 0.69:
            return Frame("confirm_question", self._values(rng, 1))
        if kind < 0.82:
            return Frame("thanks")
        if kind < 0.92:
            return Frame("deny")
        return self._slotless_act(rng)

    def _verdict(self, question: Frame, rng: random.Random) -> Frame:
        kind = rng.random()
        if kind < 0.29:
            return Frame("thanks")
        if kind < 0.46:
            return Frame("thanks", {}, self._requests(rng, rng.choice((1, 1, 1, 2))))
        if kind < 0.62:
            return Frame("deny")
        if kind < 0.82:
            slots = [slot for slot in question.informs if slot in self._valued]
            slot = rng.choice(slots)
            is_any = slot in self._asked and rng.random() < 0.2
            return Frame("inform", {slot: ANY if is_any else self._value(slot, rng)})
        if kind < 0.88:
            requests = self._requests(rng, 1)
            return Frame("request", self._values(rng, rng.choice((0, 1)), requests), requests)
        return Frame("closing") if rng.random() < 0.9 else self._slotless_act(rng)

    def _after_act(self, act: str, rng: random.Random) -> Frame:
        if act == "greeting" and rng.random() < 0.8:
            return self._opening(rng)
        if act == "confirm_question" and rng.random() < 0.75:
            return Frame(rng.choice(("confirm_answer", "confirm_answer", "deny")))
        return self._reaction(None, rng) if rng.random() < 0.6 else self._slotless_act(rng)
