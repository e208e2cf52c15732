"""Stored records of a study: participants' sessions and their exchanges."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SCALES = ("overall", "naturalness", "coherence", "completion")
"""The scales that participants rate from 1 to 5; the first is the paper's only one."""

LOWEST, HIGHEST = 1, 5
"""The lowest and the highest rating."""


def act_content(frame: Frame, confidence: float | None = None) -> dict[str, Any]:
    """Returns an act as plain data, for storage and export."""
    informs, requests = dict(frame.informs), list(frame.requests)
    return {"act": frame.act, "informs": informs, "requests": requests, "confidence": confidence}


def act_text(frame: Frame) -> str:
    """Returns an act in the notation of a study's transcripts and exports.

    Examples:
        >>> act_text(Frame("request", {"city": "reno"}, ("date",)))
        'request(city=reno, date?)'
    """
    filled = [f"{slot}={value}" for slot, value in frame.informs.items()]
    return f"{frame.act}({', '.join([*filled, *(f'{slot}?' for slot in frame.requests)])})"


def _read(text: str) -> tuple[Frame, float | None]:
    """Returns the act and the confidence that are stored as ``text``."""
    content = json.loads(text)
    frame = Frame(content["act"], content["informs"], tuple(content["requests"]))
    return frame, content["confidence"]


@dataclass(frozen=True)
class StoredExchange:
    """A participant's text and the agent's answer.

    Attributes:
        number: the number in the session, from 1.
        at: the time of storage, in seconds since 1970.
        text: the participant's text.
        answer: the agent's text.
        heard: the act understood.
        confidence: the nlu's confidence, or ``None``.
        said: the agent's act.
        beliefs: the agent's beliefs, as plain data.
        state: the talker's state.
        nonce: the nonce of the participant's message.
    """

    number: int
    at: float
    text: str
    answer: str
    heard: Frame
    confidence: float | None
    said: Frame
    beliefs: Mapping[str, Any] | None
    state: str
    nonce: str

    @classmethod
    def of(cls, row: tuple[Any, ...]) -> StoredExchange:
        """Returns the exchange in a row of :data:`EXCHANGES`."""
        number, at, text, answer, heard, said, beliefs, state, nonce = row
        content = None if beliefs is None else json.loads(beliefs)
        frames = *_read(heard), _read(said)[0]
        return cls(number, at, text, answer, *frames, content, state, nonce)


EXCHANGES = """
    SELECT number, at, text, answer, heard, said, beliefs, state, nonce FROM exchange
    WHERE session = ? ORDER BY number
"""
"""Selects the rows of a session for :meth:`StoredExchange.of`, first to last."""


@dataclass(frozen=True)
class Session:
    """A participant's past, current or future conversation.

    Attributes:
        id: the id in the file.
        person: the participant's number.
        position: the position among the participant's sessions, from 1.
        agent: the agent's name.
        goal: number of the goal in the domain, from 1.
        ended_by: ``agent``, ``person`` or ``turns``; ``None`` before the end.
        success: the judge's verdict; false before the end.
        reasons: the reasons for a failure.
        ratings: scale to 1 to 5; ``None`` before the participant rates.
        verdict: the participant's verdict; ``None`` before they rate.
        messages: the number of messages that the participant has sent.
    """

    id: int
    person: str
    position: int
    agent: str
    goal: int
    ended_by: str | None
    success: bool
    reasons: tuple[str, ...]
    ratings: Mapping[str, int] | None
    verdict: bool | None
    messages: int

    @property
    def is_ended(self) -> bool:
        """True once the conversation has ended."""
        return self.ended_by is not None

    @property
    def is_rated(self) -> bool:
        """True once the participant has rated it."""
        return self.ratings is not None

    @classmethod
    def of(cls, row: tuple[Any, ...]) -> Session:
        """Returns the session in a row of :data:`SESSIONS`."""
        number, person, position, agent, goal, ended_by, success, reasons, *rest = row
        verdict, messages, *scales = rest
        is_rated = verdict is not None
        return cls(
            id=number,
            person=str(person),
            position=position,
            agent=agent,
            goal=goal,
            ended_by=ended_by,
            success=bool(success),
            reasons=tuple(json.loads(reasons or "[]")),
            ratings=dict(zip(SCALES, scales, strict=True)) if is_rated else None,
            verdict=bool(verdict) if is_rated else None,
            messages=messages,
        )


SESSIONS = f"""
    SELECT session.id, person, position, agent, goal, ended_by, session.success, reasons, verdict,
           (SELECT COUNT(*) FROM exchange WHERE exchange.session = session.id), {", ".join(SCALES)}
    FROM session LEFT JOIN rating ON rating.session = session.id
"""
"""Selects the rows for :meth:`Session.of`."""

NOT_FORGOTTEN = "WHERE place >= 0"
"""Condition on the table ``person``: the others are forgotten, and only their number is left."""

IS_FINISHED = """NOT EXISTS (
    SELECT 1 FROM session LEFT JOIN rating ON rating.session = session.id
    WHERE session.person = person.id AND rating.session IS NULL
)"""
"""Condition on the table ``person``: the participant has rated all their conversations."""

TAKEN = f"""
    SELECT DISTINCT place FROM person
    WHERE active > ? AND (
        enrolled > ?
        OR EXISTS (
            SELECT 1 FROM session JOIN exchange ON exchange.session = session.id
            WHERE session.person = person.id
        )
    ) OR {IS_FINISHED}
"""
"""Selects the places that nobody else gets; the parameters are the earliest times of activity and,
if nothing has been said yet, of enrollment."""


def current(sessions: Sequence[Session]) -> Session | None:
    """Returns the first session that is not rated; ``None`` after a participant's last."""
    return next((session for session in sessions if not session.is_rated), None)
