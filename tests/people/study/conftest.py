"""A study of two agents with its server in this process."""

import re
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("starlette", reason="needs the extra study")

from starlette.testclient import TestClient

from bbq_torchrl.people.study import load_study
from bbq_torchrl.people.study.database import SCALES, current
from bbq_torchrl.people.study.storage import Store
from bbq_torchrl.people.study.web import JOIN, RESEARCHER, application

from .fakes import FakeTalker

STUDY = Path(__file__).with_name("tickets.yaml").read_text("utf-8")
RATED = {**dict.fromkeys(SCALES, "4"), "verdict": "yes"}


class Site:
    """A served study and what a test does with it."""

    def __init__(self, study, client, store, talker):
        self.study, self.client, self.store, self.talker = study, client, store, talker
        self.join = f"/join/{store.key(JOIN)}"
        self.researcher = f"/r/{store.key(RESEARCHER)}"

    def form(self, link, **given):
        """The form on a page, filled in."""
        return {**hidden(self.client.get(link).text), **given}

    def enroll(self):
        form = self.form(self.join, consent="yes")
        return str(self.client.post(self.join, data=form).url.path)

    def take(self, link, step, **given):
        return self.client.post(f"{link}/{step}", data=self.form(link, **given))

    def say(self, link, *texts):
        return [self.take(link, "say", text=text) for text in texts][-1]

    def session(self, link):
        return current(self.store.sessions(link.removeprefix("/p/")))

    def goal(self, link):
        return self.talker.domain.goals[self.session(link).goal - 1]


def hidden(page):
    """The hidden fields of a page's first form."""
    form = page[page.index("<form") : page.index("</form>")]
    return dict(re.findall(r'type="hidden" name="(\w+)" value="([^"]*)"', form))


@contextmanager
def published(study, *, domain=None, client=(), **terms):
    """A served study, whose file has some terms changed."""
    study = replace(study, terms=replace(study.terms, **terms))
    talker = FakeTalker(domain or study.domain)
    with closing(Store(study, talker)) as store:
        app = application(study, store, talker)
        with TestClient(app, raise_server_exceptions=False, **dict(client)) as browser:
            yield Site(study, browser, store, talker)


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
    """A time that is set by hand."""
    return SimpleNamespace(now=1_000_000.0)


@pytest.fixture(scope="session")
def spelled(loaded):
    """The study's domain as its talker spells it."""

    def other(values):
        return {slot: f"{value} otherwise" for slot, value in values.items()}

    domain = loaded.domain
    goals = [replace(goal, constraints=other(goal.constraints)) for goal in domain.goals]
    return replace(domain, records=tuple(map(other, domain.records)), goals=tuple(goals))


@pytest.fixture
def site(study, spelled):
    with published(study, domain=spelled) as site:
        yield site
