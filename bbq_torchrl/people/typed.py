"""Text as people type it, made one clean line."""

from __future__ import annotations

import unicodedata

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
            f"a message may have {MAX_CHARACTERS:,} characters, this one has {len(text):,}: "
            "please shorten it"
        )
    plain = "".join(
        " " if unicodedata.category(letter) in ("Cc", "Cs", "Zl", "Zp") else letter
        for letter in unicodedata.normalize("NFC", text)
    )
    line = " ".join(plain.split())
    if not any(unicodedata.category(letter)[0] not in "CZM" for letter in line):
        raise TextError("please write something before you send it")
    return line
