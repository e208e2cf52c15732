"""The steps of participants in a study, people or simulated users: send a message, end, rate."""

from __future__ import annotations

import hashlib
import re
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from random import Random
from types import SimpleNamespace
from typing import Protocol

from bbq_torchrl.domains import Goal
from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.dialogue import Talker
from bbq_torchrl.people.dialogue.judge import Judge
from bbq_torchrl.people.study.database import HIGHEST, LOWEST, SCALES, Exchange, Session, current
from bbq_torchrl.people.study.plan import Study
from bbq_torchrl.people.study.storage import Store
from bbq_torchrl.utils.text import TextError, clean

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


_DAY, _HOUR, _PAUSE = 86_400.0, 3_600.0, 10.0


class User(Protocol):
    """A simulated user in one conversation.

    Attributes:
        satisfied: whether it got what it wanted, as far as it knows.
    """

    satisfied: bool

    def say(self, said: Frame | None) -> str:
        """Returns its reply to the agent's act; ``None`` begins the conversation."""


def simulate(
    study: Study,
    talker: Talker,
    users: Callable[[int, int], User],
    *,
    seed: int,
    tell: Callable[[str], None] = lambda _: None,
) -> None:
    """Plays a study with simulated users, one after the other.

    They take the same steps as people (consent, conversation, rating) through the same code and
    store. Stored exchanges are not repeated, so an interrupted simulation continues.

    Args:
        study: the study; its data file is next to the study file.
        talker: the agents.
        users: makes a user from the number of its goal, from 1, and a seed.
        seed: seed of the plan, the users and their ratings.
        tell: called with progress messages.

    Raises:
        StoreError: the study's data cannot be used, or comes from people or another seed.
        ValueError: an agent cannot be loaded.
    """
    clock = SimpleNamespace(now=0.0)  # set by hand: a replayed study has the same times
    secret = f"simulated {seed}"
    with closing(
        Store(study, talker, simulated=True, secret=secret, clock=lambda: clock.now)
    ) as store:
        conversations = Conversations(study, store, talker)
        wanted = study.terms.participants
        for place in range(wanted):
            clock.now = begin = place * _DAY
            token = conversations.enroll({"nonce": _digest(seed, place), "consent": "yes"})
            user = None
            while (session := current(store.sessions(token))) is not None:
                form = {"session": str(session.position)}
                drawn = seed_of(seed, place, session.position)
                if user is None:
                    clock.now = begin + session.position * _HOUR
                    user, said, number = users(session.goal, drawn), None, 0
                if not session.is_ended or number < session.messages:
                    number += 1
                    clock.now += _PAUSE
                    form |= {"nonce": _digest(session.id, number), "turn": str(number)}
                    conversations.say(token, {**form, "text": user.say(said)})
                    said = store.exchanges(session.id)[number - 1].answered
                else:
                    ratings = drawn_ratings(user.satisfied, number, drawn)
                    form |= {name: str(rating) for name, rating in ratings.items()}
                    form["verdict"] = "yes" if user.satisfied else "no"
                    conversations.rate(token, {**form, "nonce": _digest(drawn, "rating")})
                    user = None
            if (place + 1) % 10 == 0 or place + 1 == wanted:
                tell(f"{place + 1} of {wanted} simulated users have taken part")


def _digest(*parts: object) -> str:
    return hashlib.sha256(" ".join(map(str, parts)).encode()).hexdigest()[:32]


RATING_RULE = (
    "Their own verdict is whether they have got what they wanted, as far as they know. Their "
    "ratings are drawn, each scale by itself: 4.5 after a yes and 2 after a no, less 0.1 for every "
    "message beyond the fifth, plus normal noise of standard deviation 0.75, rounded, from 1 to 5. "
    "So ratings say nothing that verdict and length do not."
)
"""The rule of :func:`drawn_ratings`, as reports state it."""


def drawn_ratings(satisfied: bool, messages: int, seed: int) -> dict[str, int]:
    """Returns a simulated user's ratings, by scale.

    Args:
        satisfied: the user's verdict.
        messages: the number of messages that it has sent.
        seed: seed of the noise.
    """
    rng, middle = Random(seed), (4.5 if satisfied else 2.0) - 0.1 * max(0, messages - 5)
    return {name: min(HIGHEST, max(LOWEST, round(rng.gauss(middle, 0.75)))) for name in SCALES}
