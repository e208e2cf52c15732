"""What a person reads of an error: one line, in which no value takes more than its share."""

from __future__ import annotations

__all__ = ["one_line", "shown"]

_VALUE = 200  # characters of a value: more than any that somebody typed
_LINE = 5_000  # characters of a sentence


def shown(value: object) -> str:
    """Returns a value as Python writes it, the middle of a long one left out.

    Example:
        >>> shown("abc"), shown(0.5)
        ("'abc'", '0.5')
        >>> len(shown("x" * 20_000_000)) < 300
        True
    """
    return _cut(_written(value), _VALUE)


def one_line(text: object) -> str:
    r"""Returns what an error says as one line, the middle of a very long one left out.

    Example:
        >>> one_line("a value\nis  wrong")
        'a value is wrong'
    """
    return _cut(" ".join(str(text).split()), _LINE)


def _written(value: object) -> str:
    try:
        return repr(value)
    except (RecursionError, ValueError):  # nested too deeply; an integer of thousands of digits
        return f"a value that is too long to be shown ({type(value).__name__})"


def _cut(text: str, length: int) -> str:
    if len(text) <= length:
        return text
    half = length // 2
    return f"{text[:half]} [... {len(text) - 2 * half} characters ...] {text[-half:]}"
