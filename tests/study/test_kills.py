"""Servers killed between and in requests: nothing that was acknowledged is lost."""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import threading
import time

import httpx2
import pytest

from bbq_torchrl.study.database import reading
from bbq_torchrl.study.store import Store

from .conftest import STUDY
from .served import ROOT, Server, Visitor

KILLS = 20
WRITER = """
import sys
from pathlib import Path
from bbq_torchrl.study.plan import Terms
from bbq_torchrl.study.store import Store
from bbq_torchrl.study.talk import Frame, Reply

store = Store(Path(sys.argv[1]), Terms.of(sys.argv[2]), {"secret-bbqn": "1", "secret-dqn": "2"})
token = store.enrol("nonce-of-the-enrolment")
session = store.person(token).current
number = len(store.exchanges(session.id))
print("ready", token, flush=True)
while True:
    number += 1
    reply = Reply(f"answer {number} " + "x" * 2000, Frame("inform"), Frame("request"))
    store.add_exchange(session, number, f"nonce {number}", f"text {number}", reply, None)
    print(number, flush=True)
"""


def test_a_writer_killed_at_any_moment_has_stored_what_it_said(study, clock):
    generator = random.Random()
    acknowledged = 0
    for _ in range(2):
        command = [sys.executable, "-c", WRITER, str(study.data), study.terms.text()]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        token = process.stdout.readline().split()[1]
        timer = threading.Timer(generator.uniform(0.01, 0.3), process.send_signal, [signal.SIGKILL])
        timer.start()
        lines = [line for line in process.stdout if line.endswith("\n")]
        process.stdout.close()
        assert process.wait() == -signal.SIGKILL
        acknowledged = int(lines[-1]) if lines else acknowledged
        store = Store(study.data, study.terms, {"secret-bbqn": "1", "secret-dqn": "2"}, clock=clock)
        stored = store.exchanges(store.person(token).current.id)
        store.close()
        assert len(stored) in (acknowledged, acknowledged + 1)
        for number, exchange in enumerate(stored, start=1):
            assert exchange.text == f"text {number}"
            assert exchange.answer.startswith(f"answer {number} x")
        acknowledged = len(stored)


class Talkative(threading.Thread):
    """A person who keeps on talking, and notes what was answered."""

    def __init__(self, visitor):
        super().__init__()
        self.visitor = visitor
        self.answered, self.unsure, self.count = [], None, 0

    def run(self):
        try:
            while True:
                self.unsure = None
                form = self.visitor.form(f"message {self.count} of {self.visitor.link[-8:]}")
                self.count += 1
                self.unsure = form
                assert self.visitor.send(form).status_code == 200
                self.answered.append(form["text"])
        except httpx2.TransportError:
            return


@pytest.mark.slow
def test_a_server_killed_twenty_times_loses_nothing_acknowledged(tmp_path):
    (tmp_path / "study.yaml").write_text(f"{STUDY}max_turns: 500\n")
    generator = random.Random()
    server = Server(tmp_path / "study.yaml")
    people = []
    for kill in range(KILLS):
        with server:
            if not people:
                visitors = [Visitor(server) for _ in range(3)]
                for visitor in visitors:
                    visitor.enrol()
                people = [Talkative(visitor) for visitor in visitors]
            for person in people:
                page = person.visitor.get(person.visitor.link).text
                assert all(text in page for text in person.answered)
                if person.unsure is not None:
                    # Sent again it is answered; it had been stored already, or it is now.
                    assert person.visitor.send(person.unsure).status_code == 200
                    person.answered.append(person.unsure["text"])
            if kill % 4:  # in requests; else between them
                people = [restarted(person) for person in people]
                time.sleep(generator.uniform(0.05, 0.6))
            server.kill()
        for person in people:
            if kill % 4:
                person.join()
        with reading(tmp_path / "study.sqlite") as connection:
            texts = [text for (text,) in connection.execute("SELECT text FROM exchange")]
        assert len(texts) == len(set(texts))
        for person in people:
            assert set(person.answered) <= set(texts)
    assert sum(len(person.answered) for person in people) > KILLS


def restarted(person):
    """The same person going on in a new thread."""
    again = Talkative(person.visitor)
    again.answered, again.count = person.answered, person.count
    again.start()
    return again


@pytest.mark.slow
def test_a_second_server_on_one_study_is_refused_and_the_first_goes_on(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    with Server(tmp_path / "study.yaml") as first:
        with pytest.raises(RuntimeError, match="another server is at work"):
            Server(tmp_path / "study.yaml").start()
        visitor = Visitor(first)
        visitor.enrol()
        assert visitor.send(visitor.form("city=philly")).status_code == 200


@pytest.mark.slow
def test_a_served_study_ends_when_it_is_told_to(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    server = Server(tmp_path / "study.yaml").start()
    server.process.send_signal(signal.SIGTERM)
    _, errors = server.process.communicate(timeout=60)
    assert errors == "interrupted while serving: the same command goes on with the study\n"


@pytest.fixture
def disk(tmp_path):
    """Runs a program with a small disk at ``disk``: as root of a namespace of its own."""
    if shutil.which("unshare") is None:
        pytest.skip("needs the program unshare")
    unshare = ["unshare", "--map-root-user", "--mount"]
    probe = "mount -t tmpfs -o size=1m none /mnt"
    if subprocess.run([*unshare, "sh", "-c", probe], capture_output=True, check=False).returncode:
        pytest.skip("needs a kernel in which a user may mount a tmpfs in a namespace")

    def run(mount, program):
        script = f"mkdir -p disk && mount -t tmpfs -o size=512k none disk && {mount}"
        code = f"{script} && {sys.executable} -c '{program}'"
        return subprocess.run(
            [*unshare, "sh", "-c", code],
            cwd=tmp_path,
            env={"PYTHONPATH": str(ROOT), "TERMS": "", "PATH": "/usr/bin:/bin"},
            capture_output=True,
            text=True,
            check=False,
        )

    return run


FULL = """
from pathlib import Path
from bbq_torchrl.study.database import Database, StoreError
database = Database(Path("disk/study.sqlite"))
stored = 0
try:
    while True:
        with database.transaction() as connection:
            values = ("x" * 4000 + str(stored), "y")
            connection.execute("INSERT INTO agent VALUES (?, ?)", values)
        stored += 1
except StoreError as error:
    print(error)
assert len(database.rows("SELECT name FROM agent")) == stored > 10
database.close()
"""
READ_ONLY = """
from pathlib import Path
from bbq_torchrl.study.database import Database, StoreError
try:
    Database(Path("disk/study.sqlite"))
except StoreError as error:
    print(error)
"""


@pytest.mark.slow
def test_a_full_disk_is_a_sentence_and_keeps_what_was_stored(disk):
    ended = disk("true", FULL.replace("'", '"'))
    assert ended.returncode == 0, ended.stderr
    assert "the disk is full" in ended.stdout


@pytest.mark.slow
def test_a_read_only_disk_is_a_sentence(disk):
    ended = disk("mount -o remount,ro disk", READ_ONLY)
    assert ended.returncode == 0, ended.stderr
    assert "cannot be" in ended.stdout or "read-only" in ended.stdout


def test_a_step_that_cannot_be_stored_is_told_and_keeps_the_text(site):
    link = site.enrol()
    # SQLite's own way to run out of room: the file may not grow any more.
    [(pages,)] = site.store._database.rows("PRAGMA page_count")
    site.store._database._connection.execute(f"PRAGMA max_page_count = {pages}")
    text = "tell me more " * 70
    while (page := site.say(link, text)).status_code == 200:
        pass
    assert page.status_code == 503
    assert "could not be stored" in page.text
    assert f'value="{text.strip()}' in page.text
    site.store._database._connection.execute("PRAGMA max_page_count = 100000")
    assert site.say(link, text).status_code == 200
