"""Dialogue acts of users and agents, with values as text."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from bbq_torchrl.domains.values import AVAILABLE, DONT_CARE, NO_MATCH, RESERVED_TEXT
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bbq_torchrl.domains.domain import Domain

ANY = RESERVED_TEXT[DONT_CARE]
"""The value of a slot that the speaker does not care about."""

NO_MATCH_TEXT, AVAILABLE_TEXT = RESERVED_TEXT[NO_MATCH], RESERVED_TEXT[AVAILABLE]
"""The agent's values if no record matches, and if a booking is possible."""

_PART = re.compile(r"(?P<act>[A-Za-z_]\w*)(?:\((?P<content>[^()]*)\))?")
_FRAME = re.compile(r"[A-Za-z_]\w*(\([^()]*\))?(\s+[A-Za-z_]\w*(\([^()]*\))?)*")


@dataclass(frozen=True)
class Frame:
    """A dialogue act of the user or the agent.

    Args:
        act: one of the domain's acts.
        informs: slot to value, in the domain's spelling; :data:`ANY` for "I do not care".
        requests: the slots asked for.
        choices: for ``multiple_choice`` only, the values offered of the one slot in ``requests``.

    Examples:
        >>> str(Frame("request", {"moviename": "wonka"}, ("theater", "date")))
        'request(theater, date) inform(moviename=wonka)'
        >>> Frame.parse("inform(city=reno) request(date)").requests
        ('date',)
    """

    act: str
    informs: Mapping[str, str] = field(default_factory=dict)
    requests: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()

    @property
    def dont_care(self) -> tuple[str, ...]:
        """The slots that the speaker does not care about."""
        return tuple(slot for slot, value in self.informs.items() if value == ANY)

    def __str__(self) -> str:
        if self.choices:
            return f"{self.act}({', '.join(f'{self.requests[0]}={v}' for v in self.choices)})"
        parts = {}
        if self.requests:
            parts["request"] = f"request({', '.join(self.requests)})"
        if self.informs:
            values = ", ".join(f"{slot}={value}" for slot, value in self.informs.items())
            parts["inform"] = f"inform({values})"
        return " ".join((parts.pop(self.act, self.act), *parts.values()))

    @classmethod
    def parse(cls, text: str, domain: Domain | None = None) -> Frame:
        """Parses a frame in the notation of transcripts.

        Args:
            text: such as ``"request(theater) inform(moviename=wonka)"``.
            domain: the domain whose acts and slots are allowed; ``None`` allows all.

        Raises:
            ValueError: if the notation is wrong, or the act or a slot is unknown.
        """
        act = ""
        informs: dict[str, str] = {}
        requests: list[str] = []
        choices: list[str] = []
        if _FRAME.fullmatch(text.strip()) is None:
            raise ValueError(
                f"a frame is written 'act', 'request(slot)' or 'inform(slot=value)', "
                f"got {shown(text)}"
            )
        for match in _PART.finditer(text):
            act = act or match["act"]
            for item in (
                re.split(r",\s+(?=\w+(?:=|,|$))", match["content"]) if match["content"] else ()
            ):
                slot, has_value, value = item.partition("=")
                if match["act"] == "multiple_choice":
                    requests, choices = [slot], [*choices, value]
                elif bool(has_value) != (match["act"] == "inform") or slot in informs:
                    raise ValueError(
                        f"a frame requests slots and informs slot=value once, got {shown(text)}"
                    )
                elif has_value:
                    informs[slot] = value
                else:
                    requests.append(slot)
        if domain is not None:
            _check(act, (*informs, *requests), domain)
        return cls(act, informs, tuple(requests), tuple(choices))


def _check(act: str, slots: tuple[str, ...], domain: Domain) -> None:
    if act not in domain.acts:
        raise ValueError(f"the act must be one of {', '.join(domain.acts)}, got {shown(act)}")
    for slot in slots:
        if slot not in domain.slots:
            raise ValueError(f"a slot must be one of {', '.join(domain.slots)}, got {shown(slot)}")
