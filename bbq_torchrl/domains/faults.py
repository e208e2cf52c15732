"""The faults of a domain: all at once, each at its place."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from bbq_torchrl.utils.text import FaultsError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

Place = tuple[str | int, ...]
"""A field of a domain and, where it has entries, which: ``("goals", 3)``, ``("policies", "rule")``.
The third item of ``("error_values", slot, value)`` says which of the slot's values."""

_IN_MEMORY = {"records": "record", "goals": "goal"}
"""The units that a person counts in a domain that is not read from files."""


class Fault(NamedTuple):
    """One thing that is wrong, and where a person finds it.

    Attributes:
        place: in the domain; empty for the form of a file.
        text: a sentence.
        file: its name; empty for a domain that is not read from files.
        unit: what the file is counted in.
        number: which of them; ``None`` for the whole file.
    """

    place: Place
    text: str
    file: str = ""
    unit: str = ""
    number: int | None = None


@dataclass
class Source:
    """The content of one file of a domain, and the faults of its form.

    Attributes:
        path: of the file.
        content: as the domain has it.
        faults: of its form; whether it fits the domain is checked by ``Domain``.
        lines: the line of each place that is known.
    """

    path: Path
    content: Any = ()
    faults: list[Fault] = field(default_factory=list)
    lines: dict[Place, int] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    def fault(self, text: str, line: int | None = None) -> None:
        """Notes what is wrong, with a line or with the file."""
        self.faults.append(Fault((), text, self.name, "line", line))

    def line(self, place: Place) -> int | None:
        """Returns the line of a place of the domain, or of the one that it is a part of."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place)

    def take(self, place: Place, read: Callable[[str, Any], Any], key: str, content: object) -> Any:
        """Returns what a key says; ``None`` where it cannot be read, which is noted."""
        try:
            return read(key, content)
        except ValueError as error:
            self.fault(str(error), self.line(place))
            return None

    def text(self) -> str | None:
        """Returns the file's text; ``None`` where it cannot be decoded, which is noted."""
        try:
            # newline="" keeps line ends inside quoted CSV fields as they are.
            with self.path.open(encoding="utf-8-sig", newline="") as file:
                return file.read()
        except UnicodeDecodeError as error:
            self.fault(f"it must be UTF-8 text: {error}")
            return None


class DomainError(FaultsError):
    """A domain that does not fit together.

    Args:
        subject: what is wrong.
        found: its faults, one or more.

    Attributes:
        found: the same, for those who can say where else a place of the domain is.
    """

    def __init__(self, subject: str, found: Iterable[Fault]) -> None:
        self.found = tuple(found)
        super().__init__(subject, tell(self.found))


def tell(found: Iterable[Fault]) -> list[str]:
    """Returns a sentence for every fault, in the order of files and lines.

    Faults of the same text are one sentence: a slot that is unknown in a thousand records is not a
    thousand faults.
    """
    places: dict[tuple[str, str, str], list[int]] = {}
    for place, text, file, unit, number in found:
        if not file and place[0] in _IN_MEMORY and len(place) > 1:
            unit, number = _IN_MEMORY[str(place[0])], int(place[1])
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
