"""Servers killed between and in requests: nothing that was acknowledged is lost."""

import random
import threading
import time
from contextlib import suppress

import httpx2
import pytest

from bbq_torchrl.people.study.database import opened

from .conftest import STUDY, hidden
from .served import Server


class Person:
    """Somebody who keeps on talking, and knows what was answered and what may not have been."""

    def __init__(self, server):
        join = server.links["for people"]
        form = {**hidden(httpx2.get(join, timeout=60).text), "consent": "yes"}
        self.link = str(httpx2.post(join, data=form, follow_redirects=True, timeout=60).url)
        self.answered, self.unsure = [], None

    def page(self):
        return httpx2.get(self.link, timeout=60).text

    def send(self):
        sent = {"data": self.unsure, "follow_redirects": True, "timeout": 60}
        assert httpx2.post(f"{self.link}/say", **sent).status_code == 200
        self.answered.append(self.unsure["text"])
        self.unsure = None

    def talk(self):
        with suppress(httpx2.TransportError):
            while True:
                text = f"message {len(self.answered)} of {self.link[-8:]}"
                self.unsure = {**hidden(self.page()), "text": text}
                self.send()


@pytest.mark.parametrize("kills", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_a_server_that_is_killed_loses_nothing_acknowledged(tmp_path, kills):
    (tmp_path / "study.yaml").write_text(f"{STUDY}max_turns: 500\n")
    server = Server(tmp_path / "study.yaml")
    people = []
    for kill in range(kills):
        with server:
            people = people or [Person(server) for _ in range(3)]
            for person in people:
                page = person.page()
                assert all(text in page for text in person.answered)
                if person.unsure is not None:
                    person.send()  # again: it had been stored already, or it is now
            # Three of four times in requests, else between them.
            talks = [threading.Thread(target=person.talk) for person in people if (kill + 1) % 4]
            for talk in talks:
                talk.start()
            if talks:
                time.sleep(random.uniform(0.05, 0.6))
                while not all(person.answered for person in people):
                    time.sleep(0.01)
        for talk in talks:
            talk.join()
        with opened(tmp_path / "study.sqlite") as connection:
            texts = [text for (text,) in connection.execute("SELECT text FROM exchange")]
        assert len(texts) == len(set(texts))
        for person in people:
            assert set(person.answered) <= set(texts)
