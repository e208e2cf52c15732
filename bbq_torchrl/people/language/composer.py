"""User sentences from frames: clauses of the grammar, combined at random."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from bbq_torchrl.domains.frames import ANY, NO_MATCH_TEXT, Frame
from bbq_torchrl.people.language.asking import OPENING, asked_slot
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.phrases import (
    Piece,
    Template,
    choose,
    expand,
    is_possible,
    plain,
)
from bbq_torchrl.people.language.words import compact

_TRIES = 8
_ASIDES = 0.2
_LISTS = 0.4
_MARKS = (". ", ", ", " ", " and ", ". ", ", ")
_AFTER_ASIDE = (", ", ". ", " so ", ", so ", " and ", "! ", " but ", ". ")
_BEFORE_ASIDE = (", ", ". ", "! ", ", ", " because ", " since ", " as ", " and ")


@dataclass
class _Turn:
    """One sentence in the making."""

    rng: random.Random
    question: Frame
    values: dict[str, list[Piece]]
    left: list[str]
    is_terse: bool
    is_booking: bool


class Composer:
    """Composes user sentences.

    Args:
        lexicon: the domain's phrases and values.
        simulated: whether the users are simulated: a value that several slots share then means the
            slot that has it most, unless another is named.
    """

    def __init__(self, lexicon: Lexicon, *, simulated: bool = False) -> None:
        self._domain, self._phrases = lexicon.domain, lexicon.phrases
        self._owners = lexicon.owners if simulated else {}
        self._rules = self._phrases.rules

    def compose(
        self,
        frame: Frame,
        question: Frame | None,
        rng: random.Random,
        paraphrase: Callable[[str, str, random.Random], str],
        *,
        is_clear: bool = False,
    ) -> list[Piece]:
        """Returns a sentence that expresses ``frame``, in pieces.

        Args:
            frame: the user's act.
            question: the agent's last act; ``None`` at the opening.
            rng: the random number generator.
            paraphrase: returns the wording of a slot's value.
            is_clear: whether a value that several slots share comes with the slot's name, and
                each clause is a sentence.
        """
        told = {slot: value for slot, value in frame.informs.items() if value != ANY}
        values = {slot: [Piece(paraphrase(slot, value, rng), slot)] for slot, value in told.items()}
        question = question or OPENING
        hidden = {
            slot
            for slot, value in told.items()
            if is_clear
            and slot not in question.requests
            and self._owners.get(compact(value), slot) != slot
        }
        left = [slot for slot in told if slot not in hidden]
        own = {slot: values[slot] for slot in left}
        is_booking = self._domain.ticket_slot in frame.requests
        turn = _Turn(rng, question, own, left, rng.random() < 0.35, is_booking)
        rng.shuffle(turn.left)
        parts = self._parts(frame, turn)
        for slot in sorted(hidden):
            clear = self._phrases.slots[slot].phrases["clear"]
            parts.append(self._fill(clear, turn, slot, {slot: values[slot]}))
        said = _join(parts, rng, [". "] if is_clear else _MARKS)
        if self._owners or turn.is_terse:
            return said  # Simulated users, the only ones with owners, make no side remarks.
        aside = partial(choose, self._rules["<aside>"], {}, self._rules, rng)
        if rng.random() < _ASIDES:
            said = [*aside(), Piece(rng.choice(_AFTER_ASIDE)), *said]
        if rng.random() < _ASIDES:
            said = [*said, Piece(rng.choice(_BEFORE_ASIDE)), *aside()]
        return said

    def _parts(self, frame: Frame, turn: _Turn) -> list[list[Piece]]:
        rng, question = turn.rng, turn.question
        cares = list(frame.dont_care)
        requests = list(frame.requests)
        rng.shuffle(requests)
        if frame.act == "request" and requests:
            parts = self._ask(requests, turn)
            requests = []
        elif frame.act == "inform" and frame.informs:
            parts = self._tell(cares, turn)
        elif frame.act == "confirm_question" and turn.left:
            parts = [self._slot_phrase(turn.left.pop(), "check", turn)]
        else:
            is_offer = self._domain.complete_slot in question.informs
            use = "accept" if frame.act == "thanks" and is_offer else frame.act
            options = self._phrases.user.get(use) or self._phrases.user["inform"]
            parts = [self._fill(options, turn, asked_slot(question))]
        while turn.left:
            slot = turn.left.pop()
            use = "with" if turn.rng.random() < 0.6 else "say"
            said = self._slot_phrase(slot, use, turn)
            parts.append(said if parts else self._wrap("state", said, turn))
        parts += [self._fill(self._phrases.slots[s].phrases["any"], turn, s) for s in cares]
        parts += [self._wrap("also", asked, turn) for asked in self._questions(requests, turn)]
        return parts

    def _ask(self, requests: Sequence[str], turn: _Turn) -> list[list[Piece]]:
        """Returns the questions, with the values around the first."""
        asked = self._questions(requests, turn)
        first = asked[0]
        front: list[Piece] = []
        while turn.left and turn.rng.random() < 0.85:
            slot = turn.left.pop()
            piece = self._slot_phrase(slot, "with", turn)
            if turn.question is OPENING and turn.rng.random() < (0.5 if turn.is_terse else 0.15):
                front += [*piece, Piece(turn.rng.choice([", ", " ", ". ", ": "]))]
            else:
                first = [*first, Piece(" "), *piece]
        first = front + first
        more = (self._wrap("also", question, turn) for question in asked[1:])
        return [self._wrap("ask", first, turn), *more]

    def _questions(self, requests: Sequence[str], turn: _Turn) -> list[list[Piece]]:
        asked = []
        if len(requests) > 1 and not self._owners and turn.rng.random() < _LISTS:
            # "When and where", "the price, the time and the theater".
            said = [self._short(slot, turn) for slot in requests]
            return [_join([_join(said[:-1], turn.rng, [", "]), said[-1]], turn.rng, [" and "])]
        for slot in requests:
            phrases = self._phrases.slots[slot].phrases
            was_asked = slot in turn.question.requests
            use = "options" if was_asked and turn.rng.random() < 0.5 else "want"
            asked.append(self._fill(phrases[use], turn, slot))
        return asked

    def _short(self, slot: str, turn: _Turn) -> list[Piece]:
        """Returns a question in a word or two, or the slot's name."""
        entry = self._phrases.slots[slot]
        plainest = [t for t in entry.phrases["want"] if is_possible(t, {}, self._rules)]
        for _ in range(_TRIES if plainest else 0):  # generic phrases need the name
            said = expand(turn.rng.choice(plainest), {}, self._rules, turn.rng)
            if len(plain(said).split()) < 3:
                return said
        return [Piece(turn.rng.choice(("the ", "")) + entry.name)]

    def _tell(self, cares: list[str], turn: _Turn) -> list[list[Piece]]:
        """Returns an answer, a correction or a statement, and removes what it says from `cares`."""
        rng, asked, wrong = turn.rng, turn.question.requests, turn.question.informs
        parts: list[list[Piece]] = []
        for slot in [slot for slot in cares if slot in asked]:
            cares.remove(slot)
            own, any_ = self._phrases.slots[slot].phrases["any"], self._phrases.user["dont_care"]
            parts.append(self._fill(own if rng.random() < 0.4 else any_, turn, slot))
        answered = [slot for slot in turn.left if slot in asked]
        corrected = [slot for slot in turn.left if slot in wrong and slot not in asked]
        if answered:
            slot = answered[0]
            turn.left.remove(slot)
            wrapper = rng.random()
            said = turn.values[slot]
            if 0.1 < wrapper < 0.45:
                said = self._slot_phrase(slot, rng.choice(["say", "say", "with"]), turn)
            if not (turn.is_terse or wrapper < 0.1 or 0.3 < wrapper < 0.45):
                said = self._fill(self._phrases.user["answer"], turn, slot, {"": said})
            parts.append(said)
        elif corrected or (wrong and turn.left and rng.random() < 0.6):
            slot = (corrected or turn.left)[0]
            turn.left.remove(slot)
            said = turn.values[slot]
            if rng.random() < 0.5:
                said = self._slot_phrase(slot, "with", turn)
            other = wrong.get(slot, "that")
            other = "that" if other in (ANY, NO_MATCH_TEXT) else other
            around = {"": said, "<wrong>": [Piece(other)]}
            parts.append(self._fill(self._phrases.user["correct"], turn, slot, around))
        elif turn.left and turn.question is OPENING:
            parts += self._open(turn)
        return parts

    def _open(self, turn: _Turn) -> list[list[Piece]]:
        """Returns a whole sentence, unless each needs a value that there is not."""
        options = self._phrases.user["open"]
        left = {slot: turn.values[slot] for slot in turn.left}
        if not any(is_possible(option, left, self._rules) for option in options):
            return []
        stated = self._fill(options, turn)
        while turn.left and turn.rng.random() < 0.9:
            slot = turn.left.pop()
            piece = self._slot_phrase(slot, "with", turn)
            mark = Piece(turn.rng.choice([" ", " ", " ", ", "]))
            stated = [*stated, mark, *piece] if turn.rng.random() < 0.9 else [*piece, mark, *stated]
        return [self._wrap("state", stated, turn)]

    def _slot_phrase(self, slot: str, use: str, turn: _Turn) -> list[Piece]:
        if slot in turn.left:
            turn.left.remove(slot)
        own = {slot: turn.values[slot]}
        nouns = self._phrases.slots[self._domain.ticket_slot].nouns
        for _ in range(_TRIES):
            said = self._fill(self._phrases.slots[slot].phrases[use], turn, slot, own)
            words = {word for piece in said if piece.slot is None for word in piece.text.split()}
            # "2 tickets" would also ask for the ticket.
            if turn.is_booking or slot in turn.question.requests or words.isdisjoint(nouns):
                break
        return said

    def _wrap(self, use: str, said: list[Piece], turn: _Turn) -> list[Piece]:
        """Returns a clause with the words around it, which a terse sentence leaves out."""
        if turn.is_terse and use != "also":
            return said
        return self._fill(self._phrases.user[use], turn, values={"q": said})

    def _fill(
        self,
        options: Sequence[Template],
        turn: _Turn,
        slot: str | None = None,
        values: Mapping[str, list[Piece]] | None = None,
    ) -> list[Piece]:
        """Returns one of the phrases, and removes its values from those left to say."""
        left = {name: turn.values[name] for name in turn.left} | dict(values or {})
        if slot is not None:
            left["<name>"] = [Piece(self._phrases.slots[slot].name)]
        possible = [option for option in options if is_possible(option, left, self._rules)]
        if turn.left and values is None:
            # Few phrases name a value themselves; most do not need one.
            richer = [t for t in possible if any(name[:1] != "<" for name in t.names())]
            if richer and turn.rng.random() < 0.4:
                possible = richer
        pieces = expand(turn.rng.choice(possible), left, self._rules, turn.rng)
        for piece in pieces:
            if piece.slot in turn.left:
                turn.left.remove(piece.slot)
        return pieces


def _join(parts: list[list[Piece]], rng: random.Random, marks: Sequence[str]) -> list[Piece]:
    """Returns the clauses, joined by random marks."""
    joined: list[Piece] = []
    for part in parts:
        if joined:
            joined.append(Piece(rng.choice(marks)))
        joined += part
    return joined
