"""Error messages with shortened values, and texts that people type."""

from __future__ import annotations

import re
import reprlib
import unicodedata
from collections.abc import Sequence

EMPTY = "–"
"""A missing value, as text and in tables."""

_VALUE = 200  # characters of a value: more than anybody types
_LINE = 5_000  # characters of a sentence
_FAULTS = 100  # lines


class FaultsError(ValueError):
    """An error that lists several faults, one a line.

    Args:
        subject: the thing at fault, such as a file.
        faults: at least one sentence.

    Attributes:
        subject: the same.
        faults: the same, as a tuple.

    Examples:
        >>> print(FaultsError("a.csv", ["line 2 is empty", "line 7 is empty"]))
        a.csv has 2 faults:
          line 2 is empty
          line 7 is empty
    """

    def __init__(self, subject: str, faults: Sequence[str]) -> None:
        # `args` stay the arguments, from which unpickling makes the error.
        self.subject, self.faults = subject, tuple(faults)

    def __str__(self) -> str:
        if len(self.faults) == 1:
            return f"{self.subject}: {self.faults[0]}"
        lines = [f"{self.subject} has {len(self.faults)} faults:", *self.faults[:_FAULTS]]
        if len(self.faults) > _FAULTS:
            lines.append(f"and {len(self.faults) - _FAULTS} more")
        return "\n  ".join(lines)


def shown(value: object) -> str:
    """Returns the ``repr`` of a value, shortened in the middle.

    Examples:
        >>> shown("abc"), shown(0.5)
        ("'abc'", '0.5')
        >>> len(shown("x" * 20_000_000))
        231
    """
    written = repr(value) if isinstance(value, str) else _container(value)
    return _cut(written, _VALUE)


def as_typed(value: object) -> str:
    """Returns a value as written on a command line."""
    text = "null" if value is None else str(value)
    return text.lower() if isinstance(value, bool) else text


def sentence(error: object) -> str:
    r"""Returns the message of an error: one line, or a line for each of several faults.

    A very long line is shortened in the middle, and the password of an address is hidden. An error
    of the operating system names its file.

    Examples:
        >>> sentence("a value\nis  wrong")
        'a value is wrong'
        >>> sentence("no answer from postgresql://me:secret@host/runs")
        'no answer from postgresql://me:***@host/runs'
    """
    if isinstance(error, OSError) and error.strerror:
        return _one_line(
            error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
        )
    if isinstance(error, FaultsError):
        first, *rest = map(_one_line, str(error).splitlines())
        return "\n  ".join([first, *rest])
    return _one_line(str(error))


_PASSWORD = re.compile(r"(\w://[^\s:/@]*):[^\s/@]+@")


def _one_line(text: str) -> str:
    return _cut(_PASSWORD.sub(r"\1:***@", " ".join(text.split())), _LINE)


def _container(value: object) -> str:
    # The built-in repr would walk all of a list of a million lists.
    few = reprlib.Repr()
    few.maxlist = few.maxtuple = few.maxdict = few.maxset = 20
    few.maxstring = few.maxother = few.maxlong = _VALUE
    try:
        return few.repr(value)
    except ValueError:  # an integer of thousands of digits
        return f"a value too long to show ({type(value).__name__})"


def _cut(text: str, length: int) -> str:
    if len(text) <= length:
        return text
    half = length // 2
    return f"{text[:half]} [... {len(text) - 2 * half} characters ...] {text[-half:]}"


MAX_CHARACTERS = 1_000
"""The longest message; nobody types more to a ticket agent."""


class TextError(ValueError):
    """Text that cannot be read as a message; the sentence is fit to be shown to its author."""


def clean(text: str) -> str:
    r"""Returns a text as one line, composed, without control and broken characters.

    Raises:
        TextError: if the text is longer than :data:`MAX_CHARACTERS`, or blank.

    Examples:
        >>> clean(" two\x00 tickets,\n please ")
        'two tickets, please'
    """
    if len(text) > MAX_CHARACTERS:
        raise TextError(
            f"a message may have at most {MAX_CHARACTERS:,} characters, this one has {len(text):,}"
        )
    plain = "".join(
        " " if unicodedata.category(letter) in ("Cc", "Cs", "Zl", "Zp") else letter
        for letter in unicodedata.normalize("NFC", text)
    )
    line = " ".join(plain.split())
    if not any(unicodedata.category(letter)[0] not in "CZM" for letter in line):
        raise TextError("a message must have at least one word, number or mark")
    return line
