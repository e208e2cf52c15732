"""Sentences of users and agents from acts; equal sessions give equal sentences."""

from __future__ import annotations

import hashlib
import math
import random
import re
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from bbq_torchrl.domains import Domain, fold
from bbq_torchrl.domains.frames import ANY, AVAILABLE_TEXT, NO_MATCH_TEXT, Frame
from bbq_torchrl.people.language.asking import Understood
from bbq_torchrl.people.language.composer import Composer
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.phrases import Piece, Template, choose, plain
from bbq_torchrl.people.language.quantities import minutes_of
from bbq_torchrl.people.language.words import pairs, word_set

_MAX_IN_CONFLICT = 4
MAX_CHOICES = 5
"""The number of choices that a sentence names."""

_NO_WISH = (ANY, NO_MATCH_TEXT, AVAILABLE_TEXT)

# Values that include their preposition: "it starts after 10pm", "it is tomorrow".
_PREPOSITION = re.compile(
    r"\b(at|on) (?=(after|around|as|before|by|in|next|this|today|tomorrow|tonight)\b)"
)


_SINGULAR = pairs("singular")
_ONE = re.compile(rf"\b(1|one) ({'|'.join(_SINGULAR)})\b")
_AN = re.compile(r"\b([Aa]) (?=[aeiou])(?!one\b|once\b|eu|uni|us[eu])", re.IGNORECASE)
_SMALL = word_set("small_in_titles")
_PROPER = re.compile(rf"\b({'|'.join(word_set('proper'))}|new year(?='s)|(may|march)(?= \d))\b")


def capitalized(value: str, capitals: frozenset[str]) -> str:
    """Returns a name in title case.

    Args:
        value: the name in lower case.
        capitals: the words to write in capitals.

    Examples:
        >>> capitalized("spider-man: across the spider-verse", frozenset())
        'Spider-Man: Across the Spider-Verse'
        >>> capitalized("amc seattle 10", frozenset({"amc"}))
        'AMC Seattle 10'
    """
    written, is_first = [], True
    for word in value.split(" "):
        if word in capitals:
            written.append(word.upper())
        elif word in _SMALL and not is_first:
            written.append(word)
        else:
            written.append("-".join(part[:1].upper() + part[1:] for part in word.split("-")))
        is_first = word.endswith(":")
    return " ".join(written)


def chance(session: str | int, turn: int, side: str) -> random.Random:
    """Returns the random generator of one turn's words, seeded by session, turn and side."""
    digest = hashlib.blake2b(f"{session}/{turn}/{side}".encode(), digest_size=8).digest()
    return random.Random(int.from_bytes(digest, "big"))


def listed(texts: Sequence[str], word: str) -> str:
    """Returns texts in a row, the last after a word: ``"a, b or c"``."""
    *most, last = texts or [""]
    return f"{', '.join(most)} {word} {last}" if most else last


def sentence(pieces: Sequence[Piece]) -> str:
    """Returns pieces as a sentence with an initial capital and a final mark."""
    text = plain(pieces)
    text = text[:1].upper() + text[1:]
    return text if text[-1:] in ".?!" else f"{text}."


class Generator:
    """Turns acts into sentences, with the phrases of a domain.

    Args:
        domain: the domain, with its ``language.yaml`` in its folder; otherwise with the generic
            phrases.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> speak = Generator(movie_domain())
        >>> speak.agent(Frame("inform", {"city": "reno"}), session=1, turn=2)
        '...'
    """

    def __init__(self, domain: Domain) -> None:
        lexicon = Lexicon(domain)
        self._domain, self._phrases, self._kinds = domain, lexicon.phrases, lexicon.kinds
        self._records = [
            {slot: fold(value) for slot, value in record.items()} for record in domain.records
        ]
        self._composer = Composer(lexicon, simulated=True)

    def user(
        self, frame: Frame, question: Frame | None = None, *, session: str | int = 0, turn: int = 0
    ) -> str:
        """Returns the sentence of a user who means ``frame``.

        Args:
            frame: the user's act.
            question: the agent's last act; ``None`` at the opening.
            session: determines the words, with ``turn``.
            turn: the number of the turn in the session.
        """
        rng = chance(session, turn, "user")
        pieces = self._composer.compose(frame, question, rng, _as_spelled, is_clear=True)
        text = sentence(pieces)
        return f"{text[:-1]}?" if frame.requests and text[-1] == "." else text

    def agent(
        self,
        frame: Frame,
        kept: Mapping[str, str] | None = None,
        *,
        session: str | int = 0,
        turn: int = 0,
    ) -> str:
        """Returns the sentence of an agent.

        Args:
            frame: the agent's act, with its values filled in.
            kept: the tracker's values; if no record matches, the answer names those in conflict.
                Values in ``frame`` count as well.
            session: determines the words, with ``turn``.
            turn: the number of the turn in the session.
        """
        rng = chance(session, turn, "agent")
        told = {slot: value for slot, value in frame.informs.items() if value != ANY}
        complete = self._domain.complete_slot
        if frame.choices:
            return self.say(
                "choose", frame.requests, choices=frame.choices, session=session, turn=turn
            )
        parts = []
        if complete in told:
            wishes = {slot: value for slot, value in told.items() if slot != complete}
            parts.append(self._tell(complete, told[complete], {**(kept or {}), **wishes}, rng))
        else:
            wishes = {**(kept or {}), **told}
            parts += [self._tell(slot, value, wishes, rng) for slot, value in told.items()]
            for use, slots in (("care", frame.dont_care), ("ask", frame.requests)):
                for slot in slots:
                    parts.append(self._fill(self._phrases.slots[slot].phrases[use], rng, slot))
        if not parts:
            agent = self._phrases.agent
            parts.append(self._fill(agent.get(frame.act) or agent["inform"], rng))
        return _polished(" ".join(sentence(part) for part in parts))

    def clarify(self, understood: Understood, *, session: str | int = 0, turn: int = 0) -> str:
        """Returns an agent's question about what it did not understand.

        Args:
            understood: the result of the nlu. The question is about its first unclear name;
                without one it asks the user to rephrase.
            session: determines the words, with ``turn``.
            turn: the number of the turn in the session.
        """
        words: dict[str, Any] = {"session": session, "turn": turn}
        if not understood.unclear:
            return self.say("again", **words)
        unclear = understood.unclear[0]
        if unclear.candidates:
            return self.say("choose", [unclear.slot], choices=unclear.candidates, **words)
        use = "denied" if unclear.is_denied else "unknown"
        return self.say(use, [unclear.slot], typed=unclear.text, **words)

    def say(
        self,
        use: str,
        slots: Sequence[str] = (),
        *,
        values: Mapping[str, str] | None = None,
        other: Mapping[str, str] | None = None,
        choices: Sequence[str] = (),
        beside: Sequence[Mapping[str, str]] = (),
        typed: str = "",
        session: str | int = 0,
        turn: int = 0,
    ) -> str:
        """Returns an agent's sentence of one of the uses in the phrases, such as ``booked``.

        Args:
            use: the use.
            slots: the slots that ``<name>`` names.
            values: slot to value, of ``<wishes>``.
            other: slot to value, of ``<other>``.
            choices: values of the first slot, of ``<choices>``.
            beside: slot to value, for each choice, said with it: "7 pm (at AMC 8)".
            typed: the user's words, of ``<words>``.
            session: determines the words, with ``turn``.
            turn: the number of the turn in the session.
        """
        rng = chance(session, turn, "agent")
        said = {
            "<name>": [Piece(listed([self._phrases.slots[slot].name for slot in slots], "and"))],
            "<choices>": [Piece(self._choices(slots, choices, beside, rng))],
            "<words>": [Piece(typed)],
            "<wishes>": self._wishes(values or {}, rng),
            "<other>": self._wishes(other or {}, rng),
        }
        return _polished(sentence(self._fill(self._phrases.agent[use], rng, None, said)))

    def _choices(
        self,
        slots: Sequence[str],
        choices: Sequence[str],
        beside: Sequence[Mapping[str, str]],
        rng: random.Random,
    ) -> str:
        """Returns the first choices, of the first slot if any, and how many more there are."""
        first = choices[:MAX_CHOICES]
        written = [self._written(slots[0], value) for value in first] if slots else [*first]
        for at, own in enumerate(beside[:MAX_CHOICES]):
            written[at] += f" ({plain(self._wishes(own, rng))})" if own else ""
        more = len(choices) - len(written)
        return listed([*written, f"one of {more} others"] if more > 1 else written, "or")

    def _tell(
        self, slot: str, value: str, wishes: Mapping[str, str], rng: random.Random
    ) -> list[Piece]:
        phrases = self._phrases.slots[slot].phrases
        if value == NO_MATCH_TEXT:
            clash = self.conflict(wishes)
            if not clash:  # the matching records do not say
                return self._fill(self._phrases.agent["no_record"], rng, slot)
            said = {"<wishes>": self._wishes({name: wishes[name] for name in clash}, rng)}
            conflict = self._fill(self._phrases.agent["conflict"], rng, None, said)
            return self._fill(phrases["none"], rng, slot, {"<conflict>": conflict})
        if self._kinds.get(slot) == "time" and math.isnan(minutes_of(value)):  # "after work"
            words = {"<choices>": [Piece(value)]}
            return self._fill(self._phrases.agent["no_clock"], rng, slot, words)
        written = self._written(slot, value)
        said = {"<wishes>": self._wishes(wishes, rng), slot: [Piece(written)]}
        return self._fill(phrases["tell"], rng, slot, said)

    def conflict(self, wishes: Mapping[str, str]) -> tuple[str, ...]:
        """Returns the fewest slots whose values no record combines; empty if one has them all.

        Args:
            wishes: slot to value; slots that never constrain the records are ignored.
        """
        ignored = (*self._domain.free_slots, *self._domain.special_slots)
        wanted = {
            slot: fold(value)
            for slot, value in wishes.items()
            if slot not in ignored and value not in _NO_WISH
        }
        matches = {
            slot: {row for row, record in enumerate(self._records) if record.get(slot) == value}
            for slot, value in wanted.items()
        }
        every = set(range(len(self._records)))
        for size in (*range(1, _MAX_IN_CONFLICT + 1), len(matches)):
            for some in combinations(matches, size):
                if not every.intersection(*(matches[slot] for slot in some)):
                    return some
        return ()

    def _wishes(self, wishes: Mapping[str, str], rng: random.Random) -> list[Piece]:
        """Returns the wishes in words, in the order of the domain's slots."""
        said: list[Piece] = []
        named = [text for text in wishes.values() if not text[:1].isdigit()]
        for slot in self._domain.slots:
            value = wishes.get(slot, ANY)
            if value in _NO_WISH or any(one.startswith(f"{value} ") for one in named):
                continue  # or said with another, as a chain with its theater
            if said:
                said.append(Piece(", "))
            phrases = self._phrases.slots[slot].phrases["wish"]
            written = self._written(slot, value)
            said += self._fill(phrases, rng, slot, {slot: [Piece(written)]})
        return said or [Piece("as you wish")]

    def _written(self, slot: str, value: str) -> str:
        """Returns a value as agents write it."""
        capitals = self._phrases.slots[slot].capitals
        return value if capitals is None else capitalized(value, capitals)

    def _fill(
        self,
        options: Sequence[Template],
        rng: random.Random,
        slot: str | None = None,
        values: Mapping[str, list[Piece]] | None = None,
    ) -> list[Piece]:
        known = dict(values or {})
        if slot is not None:
            known["<name>"] = [Piece(self._phrases.slots[slot].name)]
        return choose(options, known, self._phrases.rules, rng)


def _polished(text: str) -> str:
    """Returns a sentence with "1 ticket", "an e-bike", "tomorrow" without "on", and "Monday"."""
    text = _AN.sub(r"\1n ", text)
    text = _PROPER.sub(lambda found: found[0].title(), _PREPOSITION.sub("", text))
    return _ONE.sub(lambda found: f"{found[1]} {_SINGULAR[found[2]]}", text)


def _as_spelled(slot: str, value: str, rng: random.Random) -> str:
    return value
