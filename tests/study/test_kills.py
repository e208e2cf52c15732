"""Servers killed between and in requests: nothing that was acknowledged is lost."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import threading

import pytest

from bbq_torchrl.study.store import Store

from .conftest import STUDY
from .served import ROOT, Server

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


@pytest.mark.slow
def test_a_served_study_ends_when_it_is_told_to(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    server = Server(tmp_path / "study.yaml").start()
    server.process.send_signal(signal.SIGTERM)
    _, errors = server.process.communicate(timeout=60)
    assert errors == "interrupted while serving: the same command goes on with the study\n"


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
