"""The faults of a domain, reported together with their locations."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.utils.text import FaultsError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence


class Fault(NamedTuple):
    """One fault and its location.

    Attributes:
        field: a field of the domain.
        text: a sentence.
        entry: the index of a record or goal, or the slot of a list of values; ``None`` for the
            whole field.
        value: the value in a list of values.
    """

    field: str
    text: str
    entry: int | str | None = None
    value: str | None = None


class Source(NamedTuple):
    """The place that a field was read from.

    Attributes:
        name: the file's name; empty for a domain in memory.
        unit: the unit of an entry, such as ``"line"``.
        numbers: the number of each entry; ``None``: its index.
    """

    name: str
    unit: str = ""
    numbers: Sequence[int] | None = None


_IN_MEMORY = {"records": Source("", "record"), "goals": Source("", "goal")}


class DomainError(FaultsError):
    """An inconsistent domain.

    Args:
        subject: the domain.
        found: its faults, at least one.

    Attributes:
        found: the same, for callers that know the files.
    """

    def __init__(self, subject: str, found: Iterable[Fault]) -> None:
        self.found = tuple(found)
        super().__init__(subject, sentences(self.found, _IN_MEMORY))


def sentences(found: Iterable[Fault], sources: Mapping[str, Source], rest: str = "") -> list[str]:
    """Returns the faults as sentences, in the order of files and entries.

    Faults with the same text share one sentence: a slot that is unknown in a thousand records is
    one fault.

    Args:
        found: the faults.
        sources: the sources by field.
        rest: the file of all other fields.
    """
    places: dict[tuple[Source, str], list[int]] = {}
    for fault in found:
        source = sources.get(fault.field, Source(rest))
        numbers = places.setdefault((source._replace(numbers=None), fault.text), [])
        if isinstance(fault.entry, int):
            number = source.numbers[fault.entry] if source.numbers else fault.entry
            numbers += [number] if number not in numbers[-1:] else []
    files = list(dict.fromkeys(source.name for source, _ in places))
    in_order = sorted(places.items(), key=lambda item: (files.index(item[0][0].name), item[1][:1]))
    return [_sentence(source, text, numbers) for (source, text), numbers in in_order]


def _sentence(source: Source, text: str, numbers: list[int]) -> str:
    where = [source.name] if source.name else []
    if numbers:
        some = ", ".join(map(str, numbers[:3]))
        more = f" and {len(numbers) - 3} more" if len(numbers) > 3 else ""
        where.append(f"{source.unit}{'s' if len(numbers) > 1 else ''} {some}{more}")
    return f"{', '.join(where)}: {text}" if where else text
