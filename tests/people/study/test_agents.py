"""A study whose agents are run folders, from the study file to its results."""

from __future__ import annotations

from dataclasses import replace

import pytest
from acts import Acts

from bbq_torchrl.people.study import StudyError, agents as talkers, load_study, users
from bbq_torchrl.people.study.results import read_results
from bbq_torchrl.people.study.simulate import simulate

from .test_users import Letters

STUDY = """
name: Tickets
consent: We study assistants.
agents: {bbqn: bbqn, dqn: dqn}
pairs: [[bbqn, dqn]]
participants: 2
"""


@pytest.fixture
def study(runs):
    """Beside the runs, whose folders it names from its own folder on."""
    file = runs / "tickets.yaml"
    file.write_text(STUDY, encoding="utf-8")
    yield load_study(file)
    for left in runs.glob("tickets.*"):
        left.unlink()


@pytest.fixture(autouse=True)
def typed_acts(monkeypatch):
    """People and simulated users type acts, so that nothing has to be learned."""
    monkeypatch.setattr(talkers, "cached_understander", lambda *_: Acts())
    monkeypatch.setattr(users, "Generator", lambda _: Letters())


def test_simulated_users_take_part_in_a_study_of_trained_agents(study):
    talker = talkers.make_talker(study)
    assert len({talker.fingerprint(name) for name in study.terms.agents}) == 2
    simulate(study, talker, users.make_users(study), seed=3)
    results = read_results(study.data)
    assert results.simulated
    assert sorted(session.agent for session in results.sessions) == ["bbqn", "bbqn", "dqn", "dqn"]
    for session in results.sessions:
        goal = talker.domain.goals[session.goal - 1]
        told = session.exchanges[0].heard.informs
        assert told.items() <= goal.constraints.items()
        assert (session.exchanges[0].beliefs is not None) == (session.agent == "bbqn")
        assert session.verdict is not None
        # Agents have learned with four turns; how many there are is the study's.
        farewell = session.exchanges[-1].said.act in ("thanks", "closing")
        assert (session.ended_by == "agent") == farewell


def test_a_shipped_agent_talks_in_a_study(study):
    study = replace(study, terms=replace(study.terms, agents={"bbqn": "shipped:bbqn_map"}))
    reply = talkers.make_talker(study).reply("bbqn", None, "inform(moviename=barbie)", 0)
    assert reply.understood.informs == {"moviename": "barbie"}
    assert reply.beliefs is not None


def test_agents_that_cannot_talk_are_named_together(study, restaurant):
    agents = {"one": "shipped:nobody", "two": "nowhere", "three": "dqn"}
    terms = replace(study.terms, agents=agents)
    with pytest.raises(StudyError) as error:
        talkers.make_talker(replace(study, terms=terms, domain=restaurant))
    one, two, three = error.value.faults
    assert one.startswith("the agent one cannot be loaded: shipped:<name> must name")
    assert two.startswith("the agent two cannot be loaded: ")
    assert three.endswith("of the domain movie, which is not the study's, restaurant")
