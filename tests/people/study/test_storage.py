"""The study's file: what it has when, damaged or foreign ones, and the order of agents."""

import os
import sqlite3
from collections import Counter
from contextlib import ExitStack, closing
from dataclasses import replace
from itertools import pairwise

import pytest

from bbq_torchrl.people.study.database import SCALES, StoreError, current, opened
from bbq_torchrl.people.study.storage import Store, assignments

from .fakes import FakeTalker

NONCES = [f"nonce-number-{number:010d}" for number in range(50)]


@pytest.fixture
def open_store(study, clock):
    with ExitStack() as stack:

        def make(terms=study.terms):
            served, talker = replace(study, terms=terms), FakeTalker(study.domain)
            return stack.enter_context(closing(Store(served, talker, clock=lambda: clock.now)))

        yield make


def test_the_file_is_as_safe_as_sqlite_makes_it(open_store):
    store = open_store()
    assert store.rows("PRAGMA journal_mode") == [("wal",)]
    assert store.rows("PRAGMA synchronous") == [(2,)]
    with pytest.raises(StoreError, match="cannot store BLOB value in TEXT column"):
        store.rows("UPDATE study SET secret = x'00'")


def test_another_server_on_the_same_file_is_refused_and_the_first_goes_on(open_store):
    store = open_store()
    with pytest.raises(StoreError, match="another server is at work"):
        open_store()
    assert store.sessions(store.enroll(NONCES[0])) != []


def test_what_is_another_study_is_refused_all_at_once_but_more_people_are_welcome(
    open_store, study, monkeypatch
):
    open_store().close()
    in_another_order = dict(reversed(study.terms.agents.items()))
    terms = replace(study.terms, agents=in_another_order, max_turns=3)
    monkeypatch.setattr("bbq_torchrl.__version__", "99.0")
    monkeypatch.setattr(FakeTalker, "fingerprint", lambda *_: "other weights")
    with pytest.raises(StoreError) as error:
        open_store(terms)
    monkeypatch.undo()
    about = ("agents", "max_turns", "'secret-dqn'", "'secret-bbqn'", "bbq-torchrl", "new")
    for name, fault in zip(about, error.value.faults, strict=True):
        assert name in fault
    open_store(replace(study.terms, participants=50, url="https://lab.example/study/"))


def test_places_are_given_out_in_order_and_again_when_left(open_store, study, clock):
    store = open_store()
    tokens = [store.enroll(nonce) for nonce in NONCES[:5]]
    reply = FakeTalker(study.domain).reply("secret-dqn", None, "hello", 0)
    for token in tokens:
        store.add_exchange(current(store.sessions(token)), 1, NONCES[7], "hello", reply, None)
    assert store.enroll(NONCES[5]) is None
    clock.now += 60 * study.terms.idle_minutes - 1
    assert store.enroll(NONCES[5]) is None
    clock.now += 1
    # Three people are at work: one talks, one ends, one rates.
    says, ends, rates = (current(store.sessions(token)) for token in tokens[1:4])
    store.add_exchange(says, 2, NONCES[6], "hello", reply, None)
    store.end(ends, "person", ())
    store.rate(rates, NONCES[8], dict.fromkeys(SCALES, 3), True)
    clock.now += 1
    later = store.enroll(NONCES[6])
    assert store.enroll(NONCES[9]) is not None
    assert store.enroll(NONCES[10]) is None

    def plan(token):
        return [(session.agent, session.goal) for session in store.sessions(token)]

    assert plan(tokens[0]) == plan(later)


def test_who_has_finished_keeps_their_place(open_store, study, clock):
    store = open_store(replace(study.terms, participants=2))
    token, _ = (store.enroll(nonce) for nonce in NONCES[:2])
    for session in store.sessions(token):
        store.end(session, "person", ("wishes",))
        assert store.progress()[0]["finished"] == 0  # not before all are rated
        store.rate(session, NONCES[2], dict.fromkeys(SCALES, 3), True)
    people = {"wanted": 2, "enrolled": 2, "finished": 1}
    assert store.progress()[0] == {**people, "active": 1, "left": 0}
    clock.now += 1e9
    assert store.progress()[0] == {**people, "active": 0, "left": 1}
    assert store.enroll(NONCES[3]) is not None
    assert store.enroll(NONCES[4]) is None


def test_who_reads_sees_one_moment_of_the_study(open_store, study):
    store = open_store()
    store.enroll(NONCES[0])
    with opened(study.data) as connection:
        for nonce in NONCES[1:3]:
            assert connection.execute("SELECT COUNT(*) FROM person").fetchone() == (1,)
            store.enroll(nonce)


def changed(file, statement):
    with closing(sqlite3.connect(file)) as connection:
        connection.execute(statement)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda file: changed(file, "PRAGMA user_version = 99"),
        lambda file: os.truncate(file, file.stat().st_size // 3),
        lambda file: file.write_bytes(b"not a database at all" * 100),
        lambda file: file.write_bytes(b"SQLite format 3\0" + b"\xff" * 5_000),
        lambda file: [file.unlink(), changed(file, "CREATE TABLE dish (name)")],
    ],
    ids=["newer", "a third", "text", "only a head", "foreign"],
)
def test_a_file_that_is_newer_damaged_or_foreign_is_refused_and_left_as_it_is(
    open_store, study, spoil
):
    store = open_store()
    for nonce in NONCES[:5]:
        store.enroll(nonce)
    store.close()
    spoil(study.data)
    content = study.data.read_bytes()
    with pytest.raises(StoreError):
        open_store()
    with pytest.raises(StoreError), opened(study.data):
        pass
    assert study.data.read_bytes() == content


@pytest.mark.parametrize("pragma", ["max_page_count = 1", "query_only = ON"])
def test_what_cannot_be_written_is_a_sentence_and_keeps_what_was_stored(open_store, study, pragma):
    store = open_store(replace(study.terms, participants=1_000))
    token = store.enroll(NONCES[0])
    # SQLite's own ways: the file may not grow, or not change, any more.
    store.rows(f"PRAGMA {pragma}")
    with pytest.raises(StoreError):
        list(map(store.enroll, (f"{number:020d}" for number in range(1_000))))
    assert store.sessions(token) != []


AGENTS = {"a": 1, "ab": 2, "abc": 6, "abcd": 4, "abcde": 10, "abcdef": 6, "abcdefghij": 10}


@pytest.mark.parametrize("repeats", [1, 3])
@pytest.mark.parametrize("agents", AGENTS)
def test_in_a_block_each_agent_has_each_place_and_follows_each_other_equally_often(agents, repeats):
    size, count = AGENTS[agents], len(agents)
    for block in range(3):
        places = range(block * size, (block + 1) * size)
        plans = [assignments(n, list(agents), range(1, 51), count * repeats, "x") for n in places]
        for plan in plans:
            order = [agent for agent, _ in plan]
            rounds = {tuple(order[start : start + count]) for start in range(0, len(order), count)}
            assert len(rounds) == min(repeats, size)  # nobody has an order twice
            assert all(sorted(agents) == sorted(row) for row in rounds)
            assert len({goal for _, goal in plan}) == len(plan)
        first = [[agent for agent, _ in plan[:count]] for plan in plans]
        assert len(set(map(tuple, first))) == size
        for agents_there in zip(*first, strict=True):
            assert set(Counter(agents_there).values()) == {size // count}
        follows = Counter(pair for row in first for pair in pairwise(row))
        assert len(follows) == count * (count - 1)
        assert set(follows.values()) <= {size // count}
