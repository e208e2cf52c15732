"""Phrases with choices: ``[i want|get me] {count} tickets <please>``.

=============  ================================================================================
``[a|b]``      one of these; ``[|a]`` may be left out
``{slot}``     the value of a slot; a choice that needs a value which is not there is not taken
``<rule>``     one of the phrases of a rule
=============  ================================================================================
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import random
    from collections.abc import Iterator, Mapping, Sequence

__all__ = [
    "Piece",
    "Template",
    "TemplateError",
    "choose",
    "expand",
    "is_possible",
    "parse",
    "plain",
]

_TOKEN = re.compile(r"[\[\]|]|\{\w*\}|<\w+>|[^\[\]|{}<>]+|.", re.DOTALL)
_DEEPEST = 20


class TemplateError(ValueError):
    """A phrase that cannot be read."""


class Piece(NamedTuple):
    """A part of a sentence: text, and the slot whose value it is."""

    text: str
    slot: str | None = None


@dataclass(frozen=True)
class _Slot:
    name: str


@dataclass(frozen=True)
class _Rule:
    name: str


@dataclass(frozen=True)
class _Choice:
    options: tuple[Template, ...]


@dataclass(frozen=True)
class Template:
    """A phrase as it is read: parts one after another.

    Attributes:
        parts: texts, values, rules and choices.
    """

    parts: tuple[str | _Slot | _Rule | _Choice, ...]

    def names(self) -> Iterator[tuple[str, str]]:
        """Yields ``("slot", name)`` and ``("rule", name)`` for all that the phrase names."""
        for part in self.parts:
            if isinstance(part, _Choice):
                for option in part.options:
                    yield from option.names()
            elif isinstance(part, _Slot):
                yield "slot", part.name
            elif isinstance(part, _Rule):
                yield "rule", part.name


def parse(text: str, own: str = "") -> Template:
    """Returns the phrase that ``text`` writes; ``{}`` is the value of the slot ``own``.

    Raises:
        TemplateError: if a bracket is not closed, or opened.
    """
    tokens = _TOKEN.findall(text)
    options, rest = _options(tokens, 0, own, 0)
    if rest != len(tokens) or len(options) != 1:
        raise TemplateError(f"a phrase must close what it opens, and choose in [a|b], got {text!r}")
    return options[0]


def _options(tokens: list[str], at: int, own: str, depth: int) -> tuple[list[Template], int]:
    options: list[Template] = []
    parts: list[str | _Slot | _Rule | _Choice] = []
    if depth > _DEEPEST:
        raise TemplateError(f"a phrase must not be nested deeper than {_DEEPEST}")
    while at < len(tokens) and tokens[at] != "]":
        token = tokens[at]
        at += 1
        if token == "|":
            options.append(Template(tuple(parts)))
            parts = []
        elif token == "[":
            inner, at = _options(tokens, at, own, depth + 1)
            if at >= len(tokens):
                raise TemplateError(f"a phrase must close what it opens, got {''.join(tokens)!r}")
            parts.append(_Choice(tuple(inner)))
            at += 1
        elif token[0] == "{" and token[-1] == "}" and len(token) > 1:
            parts.append(_Slot(token[1:-1] or own))
        elif token[0] == "<" and len(token) > 2:
            parts.append(_Rule(token[1:-1]))
        elif token in "{}<>":
            raise TemplateError(f"a phrase must close what it opens, got {''.join(tokens)!r}")
        else:
            parts.append(token)
    return [*options, Template(tuple(parts))], at


def is_possible(
    template: Template,
    values: Mapping[str, Sequence[Piece]],
    rules: Mapping[str, Sequence[Template]],
) -> bool:
    """Returns whether the values that the phrase needs are there."""
    for part in template.parts:
        if isinstance(part, _Slot) and part.name not in values:
            return False
        if isinstance(part, _Rule) and f"<{part.name}>" not in values:
            if not any(is_possible(option, values, rules) for option in rules.get(part.name, ())):
                return False
        elif isinstance(part, _Choice) and not any(
            is_possible(option, values, rules) for option in part.options
        ):
            return False
    return True


def expand(
    template: Template,
    values: Mapping[str, Sequence[Piece]],
    rules: Mapping[str, Sequence[Template]],
    rng: random.Random,
) -> list[Piece]:
    """Returns one sentence of the phrase, in pieces.

    Args:
        template: the phrase; it must be possible.
        values: what stands for slots by name, and for rules by ``<name>``.
        rules: the phrases of each rule.
        rng: chooses.
    """
    pieces: list[Piece] = []
    for part in template.parts:
        if isinstance(part, str):
            pieces.append(Piece(part))
        elif isinstance(part, _Slot):
            pieces += values[part.name]
        elif isinstance(part, _Rule) and (made := values.get(f"<{part.name}>")) is not None:
            pieces += made
        else:
            options = part.options if isinstance(part, _Choice) else rules[part.name]
            pieces += choose(options, values, rules, rng)
    return pieces


def choose(
    options: Sequence[Template],
    values: Mapping[str, Sequence[Piece]],
    rules: Mapping[str, Sequence[Template]],
    rng: random.Random,
) -> list[Piece]:
    """Returns a sentence of one of those phrases that are possible; arguments as of `expand`."""
    possible = [option for option in options if is_possible(option, values, rules)]
    return expand(rng.choice(possible), values, rules, rng)


def plain(pieces: Sequence[Piece]) -> str:
    """Returns the text of pieces, spaces in order."""
    text = " ".join("".join(piece.text for piece in pieces).split())
    text = re.sub(r"\s+([,.!?;:])", r"\1", text)
    text = re.sub(r"([,.!?;:])(?:\s*[,.;:])+", r"\1", text)
    return text.strip(" ,;")
