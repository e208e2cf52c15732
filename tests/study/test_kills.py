"""Servers killed between and in requests: nothing that was acknowledged is lost."""

from __future__ import annotations

import random
import signal
import threading
import time

import httpx2
import pytest

from bbq_torchrl.study.database import reading

from .conftest import STUDY
from .served import Server, Visitor


class Talkative:
    """A person who keeps on talking, and notes what was answered."""

    def __init__(self, server):
        self.visitor = Visitor(server)
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


@pytest.mark.parametrize("kills", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_a_server_that_is_killed_loses_nothing_acknowledged(tmp_path, kills):
    (tmp_path / "study.yaml").write_text(f"{STUDY}max_turns: 500\n")
    server = Server(tmp_path / "study.yaml")
    people = []
    for kill in range(kills):
        with server:
            people = people or [Talkative(server) for _ in range(3)]
            for person in people:
                page = person.visitor.page()
                assert all(text in page for text in person.answered)
                if person.unsure is not None:
                    # Sent again it is answered; it had been stored already, or it is now.
                    assert person.visitor.send(person.unsure).status_code == 200
                    person.answered.append(person.unsure["text"])
            # Three of four times in requests, else between them.
            talks = [threading.Thread(target=person.talk) for person in people if (kill + 1) % 4]
            for talk in talks:
                talk.start()
            if talks:
                time.sleep(random.uniform(0.05, 0.6))
                while not all(person.answered for person in people):
                    time.sleep(0.01)
            server.kill()
        for talk in talks:
            talk.join()
        with reading(tmp_path / "study.sqlite") as connection:
            texts = [text for (text,) in connection.execute("SELECT text FROM exchange")]
        assert len(texts) == len(set(texts))
        for person in people:
            assert set(person.answered) <= set(texts)


@pytest.mark.slow
def test_a_served_study_ends_when_it_is_told_to(tmp_path):
    (tmp_path / "study.yaml").write_text(STUDY)
    server = Server(tmp_path / "study.yaml").start()
    server.process.send_signal(signal.SIGTERM)
    _, errors = server.process.communicate(timeout=60)
    assert errors == "interrupted while serving: the same command goes on with the study\n"
