"""The store of a study: who meets which agents, exchanges, outcomes and ratings."""

from __future__ import annotations

import hashlib
import hmac
import json
import secrets
import sqlite3
import threading
import time
from base64 import urlsafe_b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from itertools import starmap
from random import Random
from typing import Any

import bbq_torchrl
from bbq_torchrl.people.dialogue import Reply, Talker
from bbq_torchrl.people.study.database import (
    EXCHANGES,
    IS_FINISHED,
    NOT_FORGOTTEN,
    SESSIONS,
    TAKEN,
    Exchange,
    Session,
    StoreError,
    as_store_errors,
    serving,
)
from bbq_torchrl.people.study.plan import MAY_CHANGE, Study


class ForgottenError(RuntimeError):
    """The participant whose step is to be stored has been forgotten."""


class Store:
    """The data of a study, in one SQLite file, written by one thread at a time.

    When a method returns, its changes are on the disk.

    Args:
        study: the study.
        talker: the agents.
        simulated: whether the participants are simulated users.
        secret: the secret of the plan and the links; drawn unless given.
        clock: returns the time, in seconds since 1970.

    Raises:
        StoreError: the file cannot be used, or has a study of other terms, agents or version.
    """

    def __init__(
        self,
        study: Study,
        talker: Talker,
        *,
        simulated: bool = False,
        secret: str | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._path, self._terms, self._clock = study.data, study.terms, clock
        self._idle = 60 * study.terms.idle_minutes
        self._mutex = threading.RLock()
        prints = {agent: talker.fingerprint(agent) for agent in study.terms.agents}
        begun = {
            **{"terms": json.dumps(asdict(study.terms)), "fingerprints": json.dumps(prints)},
            **{"package": bbq_torchrl.__version__, "simulated": int(simulated)},
        }
        with ExitStack() as opened:
            self._connection = opened.enter_context(serving(self._path))
            with self.transaction() as connection:
                self._secret = self._begin(connection, begun, secret)
            self._opened = opened.pop_all()

    def _begin(
        self, connection: sqlite3.Connection, new: Mapping[str, Any], secret: str | None
    ) -> str:
        """Returns the study's secret; creates the study if it is new."""
        query = "SELECT secret, terms, fingerprints, package, simulated FROM study"
        if (found := connection.execute(query).fetchone()) is None:
            secret = secret or secrets.token_urlsafe(32)
            connection.execute(
                "INSERT INTO study (id, terms, fingerprints, package, simulated, secret, created) "
                "VALUES (1, ?, ?, ?, ?, ?, ?)",
                (*new.values(), secret, self._clock()),
            )
            return secret
        old_secret, *values = found
        old = dict(zip(new, values, strict=True))
        faults = [
            *_changed(old, new, "terms", "the study file says another {}"),
            *_changed(old, new, "fingerprints", "agent {!r} has other weights"),
        ]
        if old["package"] != new["package"]:
            faults.append(f"it was begun with bbq-torchrl {old['package']}")
        if old["simulated"] != new["simulated"]:
            faults.append("it must hold either people or simulated users, not both")
        if secret not in (None, old_secret):
            faults.append("it was begun with another seed")
        if faults:
            raise StoreError(str(self._path), [*faults, "a changed study needs a new file name"])
        connection.execute("UPDATE study SET terms = ?", (new["terms"],))
        return str(old_secret)

    def key(self, purpose: str) -> str:
        """Returns an unguessable word that is the same each time, such as that of a link."""
        digest = hmac.digest(self._secret.encode(), purpose.encode(), "sha256")
        return urlsafe_b64encode(digest[:24]).decode()

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Runs a block as one transaction: all of it is on the disk afterwards, or nothing.

        Raises:
            StoreError: it could not be written.
        """
        with self._mutex, as_store_errors(self._path), self._connection:  # which commits
            self._connection.execute("BEGIN IMMEDIATE")
            yield self._connection

    def rows(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        """Returns the rows of a query."""
        with self._mutex, as_store_errors(self._path):
            return self._connection.execute(query, values).fetchall()

    def close(self) -> None:
        """Closes the file and releases it to other servers."""
        with self._mutex:
            self._opened.close()

    # -- people ------------------------------------------------------------------------------------

    def enroll(self, nonce: str, ids: Mapping[str, str] | None = None) -> str | None:
        """Gives a participant a place. Returns their token, or ``None`` if all places are taken.

        The lowest free place is taken first. A place is free again if its participant has left it
        unfinished.

        Args:
            nonce: the nonce of the form; the same one gets the same token.
            ids: the stored parameters of the join link, name to value. The first value, if any,
                identifies the participant: the same one gets the same token.
        """
        participant = next(iter(ids.values())) if ids else None
        token = self.key(f"person {nonce}" if participant is None else f"participant {participant}")
        now = self._clock()
        with self.transaction() as connection:
            known = "SELECT id FROM person WHERE token = ?"
            if connection.execute(known, (hashed(token),)).fetchone():
                return token
            taken = {place for (place,) in connection.execute(TAKEN, (now - self._idle,))}
            free = (place for place in range(self._terms.participants) if place not in taken)
            if (place := next(free, None)) is None:
                return None
            person = connection.execute(
                "INSERT INTO person (token, place, enrolled, active, ids) VALUES (?, ?, ?, ?, ?)",
                (hashed(token), place, now, now, json.dumps(ids or {})),
            ).lastrowid
            terms, agents = self._terms, tuple(self._terms.agents)
            plan = assignments(place, agents, terms.goals, terms.sessions, self._secret)
            connection.executemany(
                "INSERT INTO session (person, position, agent, goal) VALUES (?, ?, ?, ?)",
                [(person, number, *item) for number, item in enumerate(plan, start=1)],
            )
        return token

    def sessions(self, token: str) -> list[Session]:
        """Returns the sessions of the participant with the token; empty if nobody has it."""
        whose = "WHERE person = (SELECT id FROM person WHERE token = ?) ORDER BY position"
        return list(starmap(Session, self.rows(f"{SESSIONS} {whose}", hashed(token))))

    # -- conversations -----------------------------------------------------------------------------

    def exchanges(self, session: int) -> list[Exchange]:
        """Returns the exchanges of a session, first to last."""
        return list(starmap(Exchange, self.rows(EXCHANGES, session)))

    def add_exchange(
        self,
        session: Session,
        number: int,
        nonce: str,
        text: str,
        reply: Reply,
        end: tuple[str, tuple[str, ...]] | None,
    ) -> None:
        """Stores both turns of an exchange and, if they are the last, the end.

        Args:
            session: the session of the exchange.
            number: the number of the exchange, from 1.
            nonce: the nonce of the message.
            text: the participant's text.
            reply: the agent's reply.
            end: the ``ended_by`` of the conversation, and the reasons for a failure; ``None`` if it
                continues.
        """
        beliefs = None if reply.beliefs is None else json.dumps(asdict(reply.beliefs))
        with self._step(session) as (connection, now):
            connection.execute(
                "INSERT INTO exchange VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    *(session.id, number, nonce, now, text, reply.text),
                    *(json.dumps(asdict(act)) for act in (reply.understood, reply.answered)),
                    *(reply.confidence, beliefs, reply.state),
                ),
            )
            if end is not None:
                _end(connection, session.id, now, *end)

    def end(self, session: Session, ended_by: str, reasons: tuple[str, ...]) -> None:
        """Stores the end of a conversation and the reasons for a failure, unless it had ended."""
        with self._step(session) as (connection, now):
            _end(connection, session.id, now, ended_by, reasons)

    @contextmanager
    def _step(self, session: Session) -> Iterator[tuple[sqlite3.Connection, float]]:
        """Runs a block as one transaction and stores its time as the participant's activity.

        Raises:
            ForgottenError: the participant is forgotten; another's session may have the id by now.
        """
        with self.transaction() as connection:
            now, whose = self._clock(), (session.id, session.person)
            known = "SELECT 1 FROM session WHERE id = ? AND person = ?"
            if connection.execute(known, whose).fetchone() is None:
                raise ForgottenError
            yield connection, now
            connection.execute("UPDATE person SET active = ? WHERE id = ?", (now, session.person))

    def rate(self, session: Session, nonce: str, scales: Mapping[str, int], verdict: bool) -> None:
        """Stores a participant's ratings (see :data:`SCALES`) and verdict."""
        with self._step(session) as (connection, now):
            connection.execute(
                "UPDATE session SET rated = ?, rating_nonce = ?, ratings = ?, verdict = ? "
                "WHERE id = ? AND rated IS NULL",
                (now, nonce, json.dumps(scales), verdict, session.id),
            )

    # -- the researcher's view ---------------------------------------------------------------------

    def progress(self) -> tuple[dict[str, int], list[Session]]:
        """Returns the progress of the study.

        Returns:
            The number of people, by ``wanted``, ``enrolled``, ``finished``, ``active`` and
            ``left``; and all sessions.
        """
        query = f"""
            SELECT COUNT(*), COUNT(*) FILTER (WHERE {IS_FINISHED}),
                   COUNT(*) FILTER (WHERE active > ? AND NOT {IS_FINISHED})
            FROM person {NOT_FORGOTTEN}
        """
        [(enrolled, finished, active)] = self.rows(query, self._clock() - self._idle)
        counts = {
            **{"wanted": self._terms.participants, "enrolled": enrolled, "finished": finished},
            **{"active": active, "left": enrolled - finished - active},
        }
        sessions = self.rows(f"{SESSIONS} ORDER BY person, position")
        return counts, list(starmap(Session, sessions))


def _end(
    connection: sqlite3.Connection, session: int, now: float, by: str, reasons: tuple[str, ...]
) -> None:
    connection.execute(
        "UPDATE session SET ended = ?, ended_by = ?, reasons = ? WHERE id = ? AND ended IS NULL",
        (now, by, json.dumps(reasons), session),
    )


def hashed(token: str) -> str:
    """Returns the hash of a token, which is stored instead: the file reveals no link."""
    return hashlib.sha256(token.encode()).hexdigest()


def _changed(
    old: Mapping[str, str], new: Mapping[str, str], column: str, fault: str
) -> Iterator[str]:
    """Yields a fault for each name of a column whose value differs and may not change."""
    before, now = json.loads(old[column]), json.loads(new[column])
    for name, value in now.items():
        # As text: the order of the agents matters too.
        if name not in MAY_CHANGE and json.dumps(before.get(name)) != json.dumps(value):
            yield fault.format(name)


def williams_rows(count: int) -> list[list[int]]:
    """Returns orders of ``count`` treatments that are balanced for first-order carry-over.

    Williams (1949): each treatment occurs equally often in each place, and follows every other one
    equally often. There are ``count`` rows, twice as many for an odd count.

    Examples:
        >>> williams_rows(4)
        [[0, 1, 3, 2], [1, 2, 0, 3], [2, 3, 1, 0], [3, 0, 2, 1]]
        >>> len(williams_rows(3))
        6
    """
    first = [(place + 1) // 2 if place % 2 else -(place // 2) % count for place in range(count)]
    rows = [[(item + shift) % count for item in first] for shift in range(count)]
    return rows if count % 2 == 0 or count == 1 else rows + [row[::-1] for row in rows]


def assignments(
    place: int, agents: Sequence[str], goals: Sequence[int], sessions: int, seed: str
) -> list[tuple[str, int]]:
    """Returns the agent and goal of each session of the participant in a place of the design.

    Places run through blocks; a block has every Williams row once, in random order. With
    more sessions than agents, further rows follow. No goal occurs twice.

    Args:
        place: the place, from 0.
        agents: the agents' names.
        goals: numbers of the goals, at least as many as sessions.
        sessions: a multiple of the number of agents.
        seed: the random seed.
    """
    rows = williams_rows(len(agents))
    block, within = divmod(place, len(rows))
    order = Random(f"{seed} block {block}").sample(range(len(rows)), len(rows))
    repeats = range(sessions // len(agents))
    sequence = [item for repeat in repeats for item in rows[order[(within + repeat) % len(rows)]]]
    drawn = Random(f"{seed} place {place}").sample(list(goals), sessions)
    return [(agents[item], goal) for item, goal in zip(sequence, drawn, strict=True)]
