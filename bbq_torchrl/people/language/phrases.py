"""The phrases of a domain: its ``language.yaml``, merged over the generic phrases.

Phrases have choices: ``[i want|get me] {count} tickets <please>``.

=============  ================================================================================
``[a|b]``      one of these; ``[|a]`` may be left out
``{slot}``     the value of a slot; a choice that needs a missing value is not taken
``<rule>``     one of the phrases of a rule
=============  ================================================================================
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from bbq_torchrl.domains import Domain
from bbq_torchrl.people.language.quantities import KINDS, Kind
from bbq_torchrl.settings import MAPPING, WORDS, Allowed, one_of, optional
from bbq_torchrl.utils.files import read_yaml
from bbq_torchrl.utils.text import FaultsError, shown

_TOKEN = re.compile(r"[\[\]|]|\{\w*\}|<\w+>|[^\[\]|{}<>]+|.", re.DOTALL)


class Piece(NamedTuple):
    """A part of a sentence: text, and the slot whose value it is."""

    text: str
    slot: str | None = None


@dataclass(frozen=True)
class _Name:
    """A slot, or a rule in angle brackets: its key in the values of a sentence."""

    key: str


@dataclass(frozen=True)
class Template:
    """A parsed phrase: a sequence of parts.

    Attributes:
        parts: texts, names of slots and rules, and choices among phrases.
    """

    parts: tuple[_Part, ...]

    def names(self) -> Iterator[str]:
        """Yields every slot ``city`` and every rule ``<please>`` that the phrase names."""
        for part in self.parts:
            if isinstance(part, _Name):
                yield part.key
            elif not isinstance(part, str):
                for option in part:
                    yield from option.names()


_Part = str | _Name | tuple[Template, ...]


def parse(text: str, own: str = "") -> Template:
    """Returns the phrase parsed from ``text``; ``{}`` is the value of the slot ``own``.

    Raises:
        ValueError: if a bracket is not closed, or opened.
    """
    tokens = iter(_TOKEN.findall(text))

    def options(*, is_inner: bool) -> tuple[Template, ...]:
        """Returns the phrases up to the bracket that closes them, or to the end."""
        found: list[list[_Part]] = [[]]
        token = ""
        for token in tokens:
            if token == "|":
                found.append([])
            elif token == "[":
                found[-1].append(options(is_inner=True))
            elif token == "]" and is_inner:
                break
            elif len(token) > 1 and token[0] in "{<":
                found[-1].append(_Name(token if token[0] == "<" else token[1:-1] or own))
            else:
                found[-1].append(token)
        is_whole = token == "]" if is_inner else len(found) == 1
        if not is_whole or any(part in [*"]{}<>"] for parts in found for part in parts):
            raise ValueError(
                f"a phrase must close what it opens, and choose in [a|b], got {shown(text)}"
            )
        return tuple(Template(tuple(parts)) for parts in found)

    return options(is_inner=False)[0]


def is_possible(
    template: Template,
    values: Mapping[str, Sequence[Piece]],
    rules: Mapping[str, Sequence[Template]],
) -> bool:
    """Returns whether all values that the phrase needs are available."""
    for part in template.parts:
        if isinstance(part, str) or (isinstance(part, _Name) and part.key in values):
            continue
        if not any(is_possible(option, values, rules) for option in _options_of(part, rules)):
            return False
    return True


def _options_of(
    part: _Name | tuple[Template, ...], rules: Mapping[str, Sequence[Template]]
) -> Sequence[Template]:
    """Returns the phrases that may stand for a part without a value."""
    return rules.get(part.key, ()) if isinstance(part, _Name) else part


def expand(
    template: Template,
    values: Mapping[str, Sequence[Piece]],
    rules: Mapping[str, Sequence[Template]],
    rng: random.Random,
) -> list[Piece]:
    """Returns one sentence of the phrase, in pieces.

    Args:
        template: the phrase; it must be possible.
        values: the pieces of slots by name, and of rules by ``<name>``.
        rules: the phrases of each rule, by ``<name>``.
        rng: the random number generator.
    """
    pieces: list[Piece] = []
    for part in template.parts:
        if isinstance(part, str):
            pieces.append(Piece(part))
        elif isinstance(part, _Name) and part.key in values:
            pieces += values[part.key]
        else:
            pieces += choose(_options_of(part, rules), values, rules, rng)
    return pieces


def choose(
    options: Sequence[Template],
    values: Mapping[str, Sequence[Piece]],
    rules: Mapping[str, Sequence[Template]],
    rng: random.Random,
) -> list[Piece]:
    """Returns a sentence of one of the possible phrases; arguments as in `expand`."""
    possible = [option for option in options if is_possible(option, values, rules)]
    return expand(rng.choice(possible), values, rules, rng)


def plain(pieces: Sequence[Piece]) -> str:
    """Returns the text of pieces, with clean spaces and marks."""
    text = " ".join("".join(piece.text for piece in pieces).split())
    text = re.sub(r"\s+([,.!?;:])", r"\1", text)
    text = re.sub(r"([,.!?;:])(?:\s*[,.;:])+", r"\1", text)
    return text.strip(" ,;")


LANGUAGE_FILE = "language.yaml"
_GENERIC = Path(__file__).with_name("generic.yaml")
GENERIC = (
    f"has no {LANGUAGE_FILE} in its folder, so it is spoken of in generic phrases; "
    "docs/your_domain.md shows how to write one"
)
"""The rest of the sentence that begins "The domain <name>"."""

_SECTIONS = ("rules", "user", "agent")
_DERIVED = ("name", "wishes", "other", "conflict", "choices", "wrong", "words", "q")
"""Rules that are filled in while a sentence is generated."""


_TEXTS = Allowed(
    "a list of texts",
    lambda value: (
        isinstance(value, list) and value != [] and all(isinstance(t, (str, int)) for t in value)
    ),
)
"""Numbers are texts here: nobody puts the aliases ``[2, two]`` in quotes."""


class PhrasesError(FaultsError):
    """Phrases that do not fit the domain: every fault, named by its key."""


@dataclass(frozen=True)
class SlotPhrases:
    """The phrases of one slot.

    Attributes:
        name: people's name for the slot.
        nouns: other words for it.
        kind: the kind of quantity of its values; ``None`` to infer it.
        aliases: the other ways to say each value.
        capitals: the words that agents write in all capitals; the others get an initial capital.
            ``None`` to write values as in the data.
        phrases: by use: ask, tell, none, care, want, options, say, with, any, wish, check, clear.
    """

    name: str
    nouns: tuple[str, ...]
    kind: Kind | None
    aliases: Mapping[str, tuple[str, ...]]
    capitals: frozenset[str] | None
    phrases: Mapping[str, tuple[Template, ...]]


@dataclass(frozen=True)
class Phrases:
    """All phrases of a domain, parsed.

    Attributes:
        rules: the phrases by rule, ``<name>``.
        user: the users' phrases by act or use.
        agent: the agents' phrases by act or use.
        slots: the phrases of each slot.
    """

    rules: Mapping[str, tuple[Template, ...]]
    user: Mapping[str, tuple[Template, ...]]
    agent: Mapping[str, tuple[Template, ...]]
    slots: Mapping[str, SlotPhrases]

    @property
    def names(self) -> dict[str, str]:
        """People's name for each slot."""
        return {slot: entry.name for slot, entry in self.slots.items()}


def load_phrases(domain: Domain) -> Phrases:
    """Returns the phrases of a domain.

    Args:
        domain: the domain whose slots the phrases may name. Without a ``language.yaml`` in its
            folder, only the generic phrases apply.

    Raises:
        PhrasesError: if the file is no YAML, or names what the domain does not have.
    """
    own: Any = {}
    source = LANGUAGE_FILE
    if domain.folder is not None and has_own_phrases(domain):
        path = domain.folder / LANGUAGE_FILE
        source = str(path)
        try:
            own = read_yaml(path.read_text(encoding="utf-8")) or {}
        except ValueError as error:
            raise PhrasesError(source, [str(error)]) from None
    reader = _Reader(domain)
    phrases = reader.read(_generic(), own)
    if reader.faults:
        raise PhrasesError(source, reader.faults)
    return phrases


@cache  # to parse it takes as long as all else
def _generic() -> dict[str, Any]:
    """Returns the phrases of any domain."""
    content: dict[str, Any] = yaml.safe_load(_GENERIC.read_text(encoding="utf-8"))
    return content


def has_own_phrases(domain: Domain) -> bool:
    """Returns whether the domain has a ``language.yaml``; otherwise its phrases are generic."""
    return domain.folder is not None and (domain.folder / LANGUAGE_FILE).is_file()


class _Reader:
    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        self.faults: list[str] = []

    def read(self, generic: dict[str, Any], own: object) -> Phrases:
        own = self._mapping("the file", own, (*_SECTIONS, "slots"))
        sections = {
            name: generic[name] | self._mapping(name, own.get(name, {})) for name in _SECTIONS
        }
        given = self._mapping("slots", own.get("slots", {}), self._domain.slots)
        self._rules = (*sections["rules"], "thing", *_DERIVED)
        read = {
            name: {key: self._templates(f"{name}.{key}", texts) for key, texts in section.items()}
            for name, section in sections.items()
        }
        slots = {
            slot: self._slot(slot, given.get(slot, {}), generic) for slot in self._domain.slots
        }
        rules = {f"<{name}>": texts for name, texts in read["rules"].items()}
        rules["<thing>"] = read["user"]["thing"]
        named = {
            rule: [name for text in texts for name in text.names() if name in rules]
            for rule, texts in rules.items()
        }
        try:
            TopologicalSorter(named).prepare()
        except CycleError as error:
            circle = " -> ".join(name.strip("<>") for name in reversed(error.args[1]))
            self.faults.append(f"rules must not name each other in a circle, got {circle}")
        phrases = Phrases(rules, read["user"], read["agent"], slots)
        if not self.faults:
            self._check_values(phrases)
        return phrases

    def _check_values(self, phrases: Phrases) -> None:
        """Adds a fault for each list whose phrases all need values that may be missing."""
        lists = {f"user.{key}": ("", texts) for key, texts in phrases.user.items()}
        lists |= {f"agent.{key}": ("", texts) for key, texts in phrases.agent.items()}
        del lists["user.open"]  # without a value, clauses with the others take its place
        for slot, entry in phrases.slots.items():
            lists |= {f"slots.{slot}.{key}": (slot, texts) for key, texts in entry.phrases.items()}
        for where, (own, texts) in lists.items():
            values = dict.fromkeys((own, "q", *(f"<{rule}>" for rule in _DERIVED)), ())
            if not any(is_possible(text, values, phrases.rules) for text in texts):
                self.faults.append(f"{where} must have a phrase without the value of another slot")

    def _slot(self, slot: str, content: Any, generic: dict[str, Any]) -> SlotPhrases:
        where = f"slots.{slot}"
        fallback = dict(generic["slot"])
        own = self._mapping(
            where, content, ("name", "nouns", "kind", "aliases", "capitals", *fallback)
        )
        name = own.get("name", slot.replace("_", " "))
        name = self._allowed(f"{where}.name", name, WORDS, slot)
        kinds = optional(one_of(*KINDS), "to find out")
        kind = self._allowed(f"{where}.kind", own.get("kind"), kinds, None)
        aliases = {
            str(value): self._texts(f"{where}.aliases.{value}", texts)
            for value, texts in self._mapping(f"{where}.aliases", own.get("aliases", {})).items()
        }
        is_offer = slot == self._domain.complete_slot
        if slot in self._domain.special_slots:
            fallback["tell"] = generic["agent"]["offer" if is_offer else "ticket"]
            fallback["none"] = generic["agent"]["no_offer" if is_offer else "no_ticket"]
        phrases = {
            key: self._templates(f"{where}.{key}", own.get(key, fallback[key]), slot)
            for key in fallback
        }
        nouns = self._texts(f"{where}.nouns", own.get("nouns", name.lower().split()))
        capitals = None
        if own.get("capitals") is not None:
            capitals = frozenset(self._texts(f"{where}.capitals", own["capitals"]))
        return SlotPhrases(name, nouns, kind, aliases, capitals, phrases)

    def _allowed(self, where: str, content: Any, allowed: Allowed, other: Any) -> Any:
        """Returns a content that is allowed, otherwise another one, and adds the fault."""
        if (fault := allowed.fault(where, content)) is None:
            return content
        self.faults.append(fault)
        return other

    def _mapping(
        self, where: str, content: Any, allowed: tuple[str, ...] | None = None
    ) -> dict[str, Any]:
        content = self._allowed(where, content, MAPPING, {})
        unknown = [key for key in content if allowed is not None and key not in allowed]
        self.faults += [
            f"{where} has the unknown key {shown(key)}; allowed are {', '.join(allowed or ())}"
            for key in unknown
        ]
        return {str(key): value for key, value in content.items() if key not in unknown}

    def _texts(self, where: str, content: Any) -> tuple[str, ...]:
        return tuple(map(str, self._allowed(where, content, _TEXTS, ())))

    def _templates(self, where: str, content: Any, own: str = "") -> tuple[Template, ...]:
        templates = []
        for text in self._texts(where, content):
            try:
                templates.append(parse(text, own))
            except ValueError as error:
                self.faults.append(f"{where}: {error}")
        for name in dict.fromkeys(name for text in templates for name in text.names()):
            kind, known = ("rule", self._rules) if name[:1] == "<" else ("slot", self._domain.slots)
            if name.strip("<>") not in (*known, "", "q"):
                self.faults.append(
                    f"{where} names the unknown {kind} {shown(name.strip('<>'))}; the {kind}s are "
                    f"{', '.join(known)}"
                )
        return tuple(templates)
