"""The faults of a domain, reported together with their locations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from bbq_torchrl.utils.text import FaultsError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

Place = tuple[str | int, ...]
"""The location of a fault: a field of the domain and, if any, the entry, as in ``("goals", 3)`` or
``("policies", "rule")``. ``("error_values", slot, value)`` locates one of a slot's values."""

_IN_MEMORY = {"records": "record", "goals": "goal"}
"""The units of a domain that is not read from files."""


class Fault(NamedTuple):
    """One fault and its location.

    Attributes:
        place: location in the domain; empty for a fault in a file's form.
        text: a sentence.
        file: the file's name; empty for a domain that is not read from files.
        unit: the file's unit, such as ``"line"``.
        number: the number of the unit; ``None`` for the whole file.
    """

    place: Place
    text: str
    file: str = ""
    unit: str = ""
    number: int | None = None


@dataclass
class Source:
    """The content of one file of a domain, and the faults in its form.

    Attributes:
        path: the file.
        content: the content as the domain's fields have it.
        faults: faults in its form; ``Domain`` checks whether the content fits.
        lines: the known line numbers by location.
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
        """Adds a fault of a line, or of the whole file."""
        self.faults.append(Fault((), text, self.name, "line", line))

    def line(self, place: Place) -> int | None:
        """Returns the line of a location in the domain, or of the entry that contains it."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place)

    def take(self, place: Place, read: Callable[[str, Any], Any], key: str, content: object) -> Any:
        """Returns the value of a key; ``None``, with a fault added, if it cannot be read."""
        try:
            return read(key, content)
        except ValueError as error:
            self.fault(str(error), self.line(place))
            return None

    def text(self) -> str | None:
        """Returns the file's text; ``None``, with a fault added, if it cannot be decoded."""
        try:
            # newline="" keeps line ends inside quoted CSV fields as they are.
            with self.path.open(encoding="utf-8-sig", newline="") as file:
                return file.read()
        except UnicodeDecodeError as error:
            self.fault(f"it must be UTF-8 text: {error}")
            return None


class DomainError(FaultsError):
    """An inconsistent domain.

    Args:
        subject: the domain or its folder.
        found: its faults, at least one.

    Attributes:
        found: the same, for callers that add file names and lines.
    """

    def __init__(self, subject: str, found: Iterable[Fault]) -> None:
        self.found = tuple(found)
        super().__init__(subject, sentences(self.found))


def sentences(found: Iterable[Fault]) -> list[str]:
    """Returns the faults as sentences, in the order of files and lines.

    Faults with the same text share one sentence: a slot that is unknown in a thousand records is
    one fault.
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
