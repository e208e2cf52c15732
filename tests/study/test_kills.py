"""Servers killed between and in requests: nothing that was acknowledged is lost."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import threading
import time

import httpx2
import pytest

from bbq_torchrl.study.database import reading
from bbq_torchrl.study.records import current
from bbq_torchrl.study.store import Store

from .conftest import STUDY
from .served import ROOT, Server, Visitor

KILLS = 20
WRITER = """
import sys
from pathlib import Path
from bbq_torchrl.study.plan import Terms
from bbq_torchrl.study.records import current
from bbq_torchrl.study.store import Store
from bbq_torchrl.study.talk import Frame, Reply

store = Store(Path(sys.argv[1]), Terms.of(sys.argv[2]), {"secret-bbqn": "1", "secret-dqn": "2"})
token = store.enrol("nonce-of-the-enrolment")
session = current(store.sessions(token))
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
        stored = store.exchanges(current(store.sessions(token)).id)
        store.close()
        assert len(stored) in (acknowledged, acknowledged + 1)
        for number, exchange in enumerate(stored, start=1):
            assert exchange.text == f"text {number}"
            assert exchange.answer.startswith(f"answer {number} x")
        acknowledged = len(stored)


class Talkative:
    """A person who keeps on talking, and notes what was answered."""

    def __init__(self, server):
        self.visitor = Visitor(server)
        self.visitor.enrol()
        self.answered, self.unsure, self.count = [], None, 0

    def talk(self):
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
            people = people or [Talkative(server) for _ in range(3)]
            for person in people:
                page = person.visitor.get(person.visitor.link).text
                assert all(text in page for text in person.answered)
                if person.unsure is not None:
                    # Sent again it is answered; it had been stored already, or it is now.
                    assert person.visitor.send(person.unsure).status_code == 200
                    person.answered.append(person.unsure["text"])
            # Three of four times in requests, else between them.
            talks = [threading.Thread(target=person.talk) for person in people if kill % 4]
            for talk in talks:
                talk.start()
            time.sleep(generator.uniform(0.05, 0.6) if talks else 0)
            server.kill()
        for talk in talks:
            talk.join()
        with reading(tmp_path / "study.sqlite") as connection:
            texts = [text for (text,) in connection.execute("SELECT text FROM exchange")]
        assert len(texts) == len(set(texts))
        for person in people:
            assert set(person.answered) <= set(texts)
    assert sum(len(person.answered) for person in people) > KILLS


@pytest.mark.slow
def test_a_served_study_ends_when_it_is_told_to(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    server = Server(tmp_path / "study.yaml").start()
    server.process.send_signal(signal.SIGTERM)
    _, errors = server.process.communicate(timeout=60)
    assert errors == "interrupted while serving: the same command goes on with the study\n"
