"""A study of two agents with its server in this process."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

pytest.importorskip("starlette", reason="needs the extra study")

from starlette.testclient import TestClient

from bbq_torchrl.study import load_study
from bbq_torchrl.study.records import SCALES, current
from bbq_torchrl.study.store import Store
from bbq_torchrl.study.web import JOIN, RESEARCHER, application

from .fakes import FakeTalker, prints

STUDY = """
name: Tickets
consent: |
  We study assistants.

  What you write is stored.
agents: {secret-bbqn: runs/vault-bbqn, secret-dqn: runs/vault-dqn}
pairs: [[secret-bbqn, secret-dqn]]
participants: 5
"""


class Clock:
    """A clock that is turned by hand."""

    now = 1_000_000.0

    def __call__(self):
        return self.now


class Site:
    """A served study and what a test does with it."""

    def __init__(self, study, client, store, talker, clock):
        self.study, self.client, self.store = study, client, store
        self.talker, self.clock = talker, clock
        self.join = f"/join/{store.key(JOIN)}"
        self.researcher = f"/r/{store.key(RESEARCHER)}"

    def enroll(self):
        form = {**hidden(self.client.get(self.join).text), "consent": "yes"}
        return str(self.client.post(self.join, data=form).url.path)

    def say(self, link, text, **changed):
        form = {**hidden(self.client.get(link).text), "text": text, **changed}
        return self.client.post(f"{link}/say", data=form)

    def rate(self, link, **changed):
        scales = dict.fromkeys(SCALES, "4")
        form = {**hidden(self.client.get(link).text), **scales, "verdict": "yes", **changed}
        return self.client.post(f"{link}/rate", data=form)

    def token(self, link):
        return link.removeprefix("/p/")

    def session(self, link):
        return current(self.store.sessions(self.token(link)))


def hidden(page):
    """The hidden fields of a page's first form."""
    form = page[page.index("<form") : page.index("</form>")]
    return dict(re.findall(r'type="hidden" name="(\w+)" value="([^"]*)"', form))


@pytest.fixture(scope="session")
def loaded(tmp_path_factory):
    """The study once for all tests; each has its data in a folder of its own."""
    file = tmp_path_factory.mktemp("study") / "study.yaml"
    file.write_text(STUDY)
    return load_study(file)


@pytest.fixture
def study(loaded, tmp_path):
    return replace(loaded, path=tmp_path / "study.yaml")


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def site(study, clock):
    talker = FakeTalker(study.domain)
    store = Store(study.data, study.terms, prints(study), clock=clock)
    with TestClient(application(study, store, talker), raise_server_exceptions=False) as client:
        yield Site(study, client, store, talker, clock)
    store.close()
