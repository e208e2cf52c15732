"""Error messages: values are shortened, secrets hidden, faults listed."""

from __future__ import annotations

import os
import re
import reprlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

_VALUE = 200  # characters of a value: more than any that somebody typed
_LINE = 5_000  # characters of a sentence
_FAULTS = 100  # lines
_SHORTEST_SECRET = 4  # characters

_concealed: dict[str, str] = {}  # what is not shown -> what is, in its place


class FaultsError(ValueError):
    """An error that lists several faults, one a line.

    Args:
        subject: what has them.
        faults: one sentence or more.

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
        # `args` stay what was given, which an error that is unpickled is made of.
        self.subject, self.faults = subject, tuple(faults)

    def __str__(self) -> str:
        if len(self.faults) == 1:
            return f"{self.subject}: {self.faults[0]}"
        lines = [f"{self.subject} has {len(self.faults)} faults:", *self.faults[:_FAULTS]]
        if len(self.faults) > _FAULTS:
            lines.append(f"and {len(self.faults) - _FAULTS} more")
        return "\n  ".join(lines)


def conceal_environment(text: str) -> None:
    """Hides from errors the values of the environment variables that a text refers to.

    Where ``${oc.env:NAME}`` is written, somebody may keep a secret out of the command line. From
    then on errors have the reference in the place of the value, if that has four characters or
    more.

    Args:
        text: that OmegaConf resolves.
    """
    for reference, name in re.findall(r"(\$\{\s*oc\.env\s*:\s*['\"]?([^'\",}\s]+))", text):
        value = os.environ.get(name, "")
        if len(value) >= _SHORTEST_SECRET:
            written = reference.rstrip("'\"") + "}"
            for spelling in (value, repr(value)[1:-1], " ".join(value.split())):
                _concealed[spelling] = written


def _without_secrets(text: str) -> str:
    """Returns a text without what is to be concealed."""
    for value in sorted(_concealed, key=len, reverse=True):
        text = text.replace(value, _concealed[value])
    return text


def shown(value: object) -> str:
    """Returns a value as Python writes it, the middle of a long one left out.

    Examples:
        >>> shown("abc"), shown(0.5)
        ("'abc'", '0.5')
        >>> len(shown("x" * 20_000_000)) < 300
        True
    """
    written = repr(value) if isinstance(value, str) else _container(value)
    return _cut(_without_secrets(written), _VALUE)


def sentence(error: object) -> str:
    r"""Returns what an error says: one line, or one for each fault of a :class:`FaultsError`.

    The middle of a very long line is left out. An error of the operating system has its file.

    Examples:
        >>> sentence("a value\nis  wrong")
        'a value is wrong'
    """
    if isinstance(error, OSError) and error.strerror:
        return _one_line(
            error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
        )
    if isinstance(error, FaultsError):
        first, *rest = map(_one_line, str(error).splitlines())
        return "\n  ".join([first, *rest])
    return _one_line(str(error))


def _one_line(text: str) -> str:
    return _cut(" ".join(_without_secrets(text).split()), _LINE)


def _container(value: object) -> str:
    # Python's own repr walks all of a list that holds a million lists.
    few = reprlib.Repr()
    few.maxlist = few.maxtuple = few.maxdict = few.maxset = 20
    few.maxstring = few.maxother = few.maxlong = _VALUE
    try:
        return few.repr(value)
    except ValueError:  # an integer of thousands of digits
        return f"a value that is too long to be shown ({type(value).__name__})"


def _cut(text: str, length: int) -> str:
    if len(text) <= length:
        return text
    half = length // 2
    return f"{text[:half]} [... {len(text) - 2 * half} characters ...] {text[-half:]}"
