"""A study whose agents are run folders, from the study file to the report."""

from __future__ import annotations

import pytest

pytest.importorskip("starlette", reason="needs the extra study")

from starlette.testclient import TestClient
from study.conftest import STUDY, Clock, Site

from bbq_torchrl.chat import talker as talkers
from bbq_torchrl.study import StudyError, load_study
from bbq_torchrl.study.report import write_report
from bbq_torchrl.study.results import read_results
from bbq_torchrl.study.store import Store
from bbq_torchrl.study.web import application

from .conftest import Acts


@pytest.fixture
def study(runs):
    """Beside the runs, whose folders it names from its own folder on."""
    file = runs / "tickets.yaml"
    file.write_text(
        STUDY.replace("runs/vault-bbqn", "bbqn").replace("runs/vault-dqn", "dqn"), encoding="utf-8"
    )
    yield load_study(file)
    for left in runs.glob("tickets.*"):
        left.unlink()


@pytest.fixture(autouse=True)
def typed_acts(monkeypatch):
    """People type acts, so that nothing has to be learned."""
    monkeypatch.setattr(talkers, "make_ears", lambda *_: Acts())


def test_people_talk_with_trained_agents_and_are_reported(study, tmp_path):
    talker = talkers.make_talker(study)
    prints = {name: talker.fingerprint(name) for name in study.terms.agents}
    assert len(set(prints.values())) == 2
    store = Store(study.data, study.terms, prints, clock=Clock())
    with TestClient(application(study, store, talker), raise_server_exceptions=False) as client:
        site = Site(study, client, store, talker, Clock())
        link = site.enrol()
        for _ in range(2):
            session = site.session(link)
            page = site.say(link, "request(ticket) inform(moviename=barbie)").text
            stored = store.exchanges(session.id)
            assert stored[0].heard.informs == {"moviename": "barbie"}
            assert (stored[0].beliefs is not None) == (session.agent == "secret-bbqn")
            if not store.session(session.id).is_ended:
                page = site.say(link, "closing").text
            assert "secret" not in page
            assert 'name="overall"' in page
            transcript = client.get(f"{site.researcher}/{session.id}").text
            assert "moviename=barbie" in transcript
            site.rate(link)
    store.close()
    results = read_results(study.data)
    assert {session.agent for session in results.sessions} == set(study.terms.agents)
    write_report(tmp_path / "report", results)
    assert (tmp_path / "report" / "success.png").stat().st_size > 0


def test_a_shipped_agent_talks_in_a_study(runs):
    file = runs / "tickets.yaml"
    text = STUDY.replace("runs/vault-bbqn", "shipped:bbqn_map").replace("runs/vault-dqn", "dqn")
    file.write_text(text, encoding="utf-8")
    talker = talkers.make_talker(load_study(file))
    reply = talker.reply("secret-bbqn", None, "inform(moviename=barbie)", 0)
    assert reply.heard.informs == {"moviename": "barbie"}
    assert reply.beliefs is not None
    file.write_text(text.replace("shipped:bbqn_map", "shipped:nobody"), encoding="utf-8")
    with pytest.raises(StudyError, match="secret-bbqn cannot be loaded: shipped:<name> must name"):
        talkers.make_talker(load_study(file))
    file.unlink()


def test_agents_that_cannot_talk_are_named_together(study, runs):
    (runs / "dqn").rename(runs / "moved")
    try:
        with pytest.raises(StudyError, match="the agent secret-dqn cannot be loaded"):
            talkers.make_talker(study)
    finally:
        (runs / "moved").rename(runs / "dqn")
