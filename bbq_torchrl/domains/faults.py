"""What is wrong with a domain: every fault at once, each at its place."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from bbq_torchrl.text import FaultsError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

__all__ = ["DomainError", "Fault", "Located", "Location", "Place", "Source", "tell"]

Place = tuple[str | int, ...]
"""A field of a domain and, where it has entries, which: ``("goals", 3)``, ``("policies", "rule")``.
The third item of ``("error_values", slot, value)`` says which of the slot's values."""


class Fault(NamedTuple):
    """One thing that is wrong.

    Attributes:
        place: in the domain.
        text: a sentence.
    """

    place: Place
    text: str


class Location(NamedTuple):
    """Where a person finds a place: ``("goals.jsonl", "line", 7)``.

    Attributes:
        file: its name; empty for a domain that is not read from files.
        unit: what the file is counted in.
        number: which of them; ``None`` for the whole file.
    """

    file: str = ""
    unit: str = ""
    number: int | None = None


Located = tuple[Location, str]
"""A fault where a person finds it: its text, after the location."""


@dataclass
class Source:
    """What could be read of one file of a domain, and what is wrong with its form.

    Attributes:
        name: of the file.
        content: as the domain has it.
        faults: of its form; whether it fits the domain is checked by ``Domain``.
        lines: the line of each place that is known.
    """

    name: str
    content: Any = ()
    faults: list[Located] = field(default_factory=list)
    lines: dict[Place, int] = field(default_factory=dict)

    def fault(self, text: str, line: int | None = None) -> None:
        """Notes what is wrong, with a line or with the file."""
        self.faults.append((Location(self.name, "line", line), text))

    def locate(self, place: Place) -> Location:
        """Returns where a place of the domain, or the one that it is a part of, is in the file."""
        while place and place not in self.lines:
            place = place[:-1]
        return Location(self.name, "line", self.lines.get(place))

    def text(self, path: Path) -> str | None:
        """Returns the file's text; ``None`` where it is none, which is noted."""
        try:
            # newline="" keeps line ends inside quoted CSV fields as they are.
            with path.open(encoding="utf-8-sig", newline="") as file:
                return file.read()
        except UnicodeDecodeError as error:
            self.fault(f"it must be UTF-8 text: {error}")
            return None


class DomainError(FaultsError):
    """A domain that does not fit together.

    Args:
        subject: what is wrong.
        located: its faults, one or more.
        found: the same by their places in the domain, for those who can say where that is.

    Attributes:
        found: the same.
    """

    def __init__(
        self, subject: str, located: Iterable[Located], found: Iterable[Fault] = ()
    ) -> None:
        self.found = tuple(found)
        super().__init__(subject, tell(located))

    @classmethod
    def of(cls, subject: str, found: Iterable[Fault]) -> DomainError:
        """The error of a domain that is not read from files."""
        found = tuple(found)
        return cls(subject, [(_in_memory(place), text) for place, text in found], found)


def tell(located: Iterable[Located]) -> list[str]:
    """Returns a sentence for every fault, in the order of files and lines.

    Faults of the same text are one sentence: a slot that is unknown in a thousand records is not a
    thousand faults.
    """
    places: dict[tuple[str, str, str], list[int]] = {}
    for (file, unit, number), text in located:
        numbers = places.setdefault((file, unit if number is not None else "", text), [])
        if number is not None and number not in numbers[-1:]:
            numbers.append(number)
    files = list(dict.fromkeys(file for file, _, _ in places))
    in_order = sorted(places.items(), key=lambda item: (files.index(item[0][0]), item[1][:1]))
    return [_sentence(*key, numbers) for key, numbers in in_order]


def _sentence(file: str, unit: str, text: str, numbers: list[int]) -> str:
    where = [file] if file else []
    if numbers:
        some = ", ".join(map(str, numbers[:3]))
        more = f" and {len(numbers) - 3} more" if len(numbers) > 3 else ""
        where.append(f"{unit}{'s' if len(numbers) > 1 else ''} {some}{more}")
    return f"{', '.join(where)}: {text}" if where else text


def _in_memory(place: Place) -> Location:
    units = {"records": "record", "goals": "goal"}
    field = place[0]
    if field in units and len(place) > 1:
        return Location("", units[str(field)], int(place[1]))
    return Location()
