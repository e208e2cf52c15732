"""The steps of participants in a study: send a message, end the conversation, rate it."""

from __future__ import annotations

import hashlib
import re
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from bbq_torchrl.people.dialogue.judge import Judge
from bbq_torchrl.people.study.database import SCALES, current
from bbq_torchrl.utils.text import TextError, clean

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from bbq_torchrl.domains import Goal
    from bbq_torchrl.domains.frames import Frame
    from bbq_torchrl.people.dialogue import Talker
    from bbq_torchrl.people.study.database import Exchange, Session
    from bbq_torchrl.people.study.plan import Study
    from bbq_torchrl.people.study.storage import Store

_NONCE = re.compile(r"[A-Za-z0-9_-]{20,40}", re.ASCII)
_ID = re.compile(r"[A-Za-z0-9_][\w.:@+=~-]{0,127}", re.ASCII)
"""An id in the join link: neither a spreadsheet formula nor a placeholder left unfilled."""
_LOCKS = 64


class RefusedError(ValueError):
    """A step that cannot be taken.

    Args:
        status: the status of the page that says so.
        text: the sentence on the page.
    """

    def __init__(self, status: int, text: str) -> None:
        self.status = status
        super().__init__(text)


class Conversations:
    """The steps of participants in a study.

    Args:
        study: the study.
        store: the study's store.
        talker: the agents.
    """

    def __init__(self, study: Study, store: Store, talker: Talker) -> None:
        self._study, self._store, self._talker = study, store, talker
        self._judge = Judge(talker.domain)
        self._locks = [threading.Lock() for _ in range(_LOCKS)]

    def enroll(self, form: Mapping[str, str], ids: Mapping[str, str] | None = None) -> str:
        """Returns the token of a new participant.

        Args:
            form: the consent form.
            ids: the result of :func:`ids_of`; the same person gets the same token.

        Raises:
            RefusedError: without consent, or if the study is full.
        """
        nonce = _nonce(form)
        if form.get("consent") != "yes":
            raise RefusedError(422, "To take part, please tick the box first.")
        token = self._store.enroll(nonce, ids)
        if token is None:
            text = "All places are taken. Should somebody leave, this page will let you in later."
            raise RefusedError(409, text)
        return token

    def say(self, token: str, form: Mapping[str, str]) -> None:
        """Answers a participant's message. A message already answered changes nothing.

        Raises:
            RefusedError: if the message is refused; it says what the participant may do instead.
        """
        with self._step(token, form) as (session, nonce):
            exchanges = self._store.exchanges(session.id)
            if any(item.nonce == nonce for item in exchanges):
                return
            if session.is_ended:
                raise RefusedError(409, "That conversation has ended; your message was not sent.")
            number = len(exchanges) + 1
            if form.get("turn") != str(number):
                text = "The conversation continued in another window; your message was not sent."
                raise RefusedError(409, text)
            try:
                text = clean(form.get("text", ""))
            except TextError as error:
                raise RefusedError(422, f"Your message was not sent: {error}.") from error
            state = exchanges[-1].state if exchanges else None
            reply = self._talker.reply(session.agent, state, text, seed_of(session.id, number))
            said = [*_frames(exchanges), (reply.understood, reply.answered)]
            end = None
            if reply.ended:
                end = ("agent", self._judge.reasons(self._goal(session), said))
            elif number >= self._study.terms.max_turns:
                end = ("turns", self._judge.reasons(self._goal(session), said, in_time=False))
            self._store.add_exchange(session, number, nonce, text, reply, end)

    def end(self, token: str, form: Mapping[str, str]) -> None:
        """Ends a conversation at the participant's request. One that has ended stays ended.

        Raises:
            RefusedError: nothing has been said yet.
        """
        with self._step(token, form) as (session, _):
            exchanges = self._store.exchanges(session.id)
            if not exchanges:
                raise RefusedError(409, "Please say something to the assistant before you end.")
            reasons = self._judge.reasons(self._goal(session), _frames(exchanges))
            self._store.end(session, "person", reasons)

    def rate(self, token: str, form: Mapping[str, str]) -> None:
        """Stores a participant's ratings. The same form sent again changes nothing.

        Raises:
            RefusedError: a rating is missing or out of range, or the session was rated before.
        """
        with self._step(token, form) as (session, nonce):
            if session.rating_nonce == nonce:
                return
            if session.is_rated:
                raise RefusedError(409, "You have rated it already; your first ratings count.")
            if not session.is_ended:
                raise RefusedError(409, "Please end the conversation before you rate it.")
            scales = {name: form.get(name, "") for name in SCALES}
            for name, rating in scales.items():
                if rating not in ("1", "2", "3", "4", "5"):
                    raise RefusedError(422, f"Please rate {name} by a whole number from 1 to 5.")
            verdict = {"yes": True, "no": False}.get(form.get("verdict", ""))
            if verdict is None:
                raise RefusedError(422, "Please say whether you got what you wanted: yes or no.")
            ratings = {name: int(rating) for name, rating in scales.items()}
            self._store.rate(session, nonce, ratings, verdict)

    @contextmanager
    def _step(self, token: str, form: Mapping[str, str]) -> Iterator[tuple[Session, str]]:
        """Yields the session and nonce of a form; a participant takes one step at a time."""
        nonce = _nonce(form)
        with self._locks[hash(token) % _LOCKS]:
            yield _session(self._store.sessions(token), form), nonce

    def _goal(self, session: Session) -> Goal:
        return self._talker.domain.goals[session.goal - 1]


def ids_of(names: Sequence[str], values: Callable[[str], Sequence[str]]) -> dict[str, str]:
    """Returns the parameters of a join link that are stored with a participant, by name.

    Args:
        names: the names of the parameters; the first one is required.
        values: returns the link's values for a name.

    Raises:
        RefusedError: the first is missing, or one of them occurs twice or is not an id.
    """
    found = {}
    for name in names:
        given = [value for value in values(name) if value]
        if len(given) == 1 and _ID.fullmatch(given[0]):
            found[name] = given[0]
        elif given or name == names[0]:
            text = f"In your link {name} must be one id of letters, digits and . : @ + = ~ _ -"
            raise RefusedError(400, f"{text}. Please open it from where you were invited.")
    return found


def _frames(exchanges: Sequence[Exchange]) -> list[tuple[Frame, Frame]]:
    return [(item.understood, item.answered) for item in exchanges]


def seed_of(*parts: object) -> int:
    """Returns a seed below 2**32 that depends only on the parts."""
    digest = hashlib.sha256(" ".join(map(str, parts)).encode()).digest()
    return int.from_bytes(digest[:4], "big")


def _nonce(form: Mapping[str, str]) -> str:
    nonce = form.get("nonce", "")
    if not _NONCE.fullmatch(nonce):
        raise RefusedError(400, "This form is incomplete: please open your link again.")
    return nonce


def _session(sessions: Sequence[Session], form: Mapping[str, str]) -> Session:
    """Returns the session of a form: the participant's current one or an earlier one."""
    given, now = form.get("session", ""), current(sessions)
    for session in sessions:
        if str(session.position) == given and (session.is_rated or session is now):
            return session
    raise RefusedError(400, "This form is of another conversation: please open your link again.")
