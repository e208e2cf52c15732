"""Phrases with choices: ``[i want|get me] {count} tickets <please>``.

=============  ================================================================================
``[a|b]``      one of these; ``[|a]`` may be left out
``{slot}``     the value of a slot; a choice that needs a missing value is not taken
``<rule>``     one of the phrases of a rule
=============  ================================================================================
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    import random
    from collections.abc import Iterator, Mapping, Sequence

_TOKEN = re.compile(r"[\[\]|]|\{\w*\}|<\w+>|[^\[\]|{}<>]+|.", re.DOTALL)
_DEEPEST = 20


class TemplateError(ValueError):
    """A phrase that cannot be parsed."""


class Piece(NamedTuple):
    """A part of a sentence: text, and the slot whose value it is."""

    text: str
    slot: str | None = None


@dataclass(frozen=True)
class _Name:
    kind: Literal["slot", "rule"]
    name: str

    @cached_property
    def key(self) -> str:
        """Its key in the values of a sentence."""
        return self.name if self.kind == "slot" else f"<{self.name}>"


@dataclass(frozen=True)
class Template:
    """A parsed phrase: a sequence of parts.

    Attributes:
        parts: texts, names of slots and rules, and choices among phrases.
    """

    parts: tuple[_Part, ...]

    def names(self) -> Iterator[tuple[str, str]]:
        """Yields ``("slot", name)`` and ``("rule", name)`` for every name in the phrase."""
        for part in self.parts:
            if isinstance(part, tuple):
                for option in part:
                    yield from option.names()
            elif isinstance(part, _Name):
                yield part.kind, part.name


_Part = str | _Name | tuple[Template, ...]


def parse(text: str, own: str = "") -> Template:
    """Returns the phrase parsed from ``text``; ``{}`` is the value of the slot ``own``.

    Raises:
        TemplateError: if a bracket is not closed, or opened.
    """
    tokens = iter(_TOKEN.findall(text))
    fault = TemplateError(
        f"a phrase must close what it opens, and choose in [a|b], got {shown(text)}"
    )

    def options(depth: int) -> tuple[Template, ...]:
        """Returns the phrases up to the bracket that closes them, or to the end."""
        if depth > _DEEPEST:
            raise TemplateError(f"a phrase must not be nested deeper than {_DEEPEST}")
        found: list[Template] = []
        parts: list[_Part] = []
        for token in tokens:
            if token == "|":
                found.append(Template(tuple(parts)))
                parts = []
            elif token == "[":
                parts.append(options(depth + 1))
            elif token == "]" and depth:
                break
            elif len(token) > 1 and token[0] in "{<":
                is_slot = token[0] == "{"
                parts.append(_Name("slot" if is_slot else "rule", token[1:-1] or own))
            elif token in "]{}<>":
                raise fault
            else:
                parts.append(token)
        else:
            if depth:
                raise fault
        return (*found, Template(tuple(parts)))

    read = options(0)
    if len(read) != 1:
        raise fault
    return read[0]


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
    if isinstance(part, tuple):
        return part
    return rules.get(part.name, ()) if part.kind == "rule" else ()


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
        rules: the phrases of each rule.
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
