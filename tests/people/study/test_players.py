"""Trained agents and the simulator's users in a study, and turn by turn as in the simulator."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from acts import Acts

pytest.importorskip("pycrfsuite", reason="needs the extra language")

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.frames import Coding, Frame
from bbq_torchrl.people.language import Generator
from bbq_torchrl.people.study import StudyError, load_study, players
from bbq_torchrl.people.study.conversations import simulate
from bbq_torchrl.people.study.outcomes import read_outcomes
from bbq_torchrl.people.study.players import SimulatedUser
from bbq_torchrl.simulator import Simulator


class Letters(Generator):
    """A user says frames as transcripts write them."""

    def __init__(self, domain=None):
        if domain is not None:
            super().__init__(domain)

    def user(self, frame, question=None, *, session=0, turn=0):
        self.question = question
        return str(frame)


@pytest.fixture
def study(runs, monkeypatch):
    """Beside the runs, whose folders it names; people type acts, so that nothing is learned."""
    monkeypatch.setattr(players, "cached_understander", lambda *_: Acts())
    monkeypatch.setattr(players, "Generator", Letters)
    file = runs / "trained.yaml"
    shutil.copyfile(Path(__file__).with_name("trained.yaml"), file)
    yield load_study(file)
    for left in runs.glob("trained.*"):
        left.unlink()


def test_simulated_users_take_part_in_a_study_of_trained_agents(study):
    talker = players.make_talker(study)
    assert len({talker.fingerprint(name) for name in study.terms.agents}) == 3
    simulate(study, talker, players.make_users(study), seed=3)
    outcomes = read_outcomes(study.data)
    assert outcomes.simulated
    assert sorted(session.agent for session in outcomes.sessions) == ["bbqn", "dqn", "public"]
    beliefs = {s.agent: [one.beliefs for one in s.exchanges] for s in outcomes.sessions}
    assert any(one is not None for one in [*beliefs["bbqn"], *beliefs["public"]])
    assert all(one is None for one in beliefs["dqn"])
    for session in outcomes.sessions:
        goal = talker.domain.goals[session.goal - 1]
        assert session.exchanges[0].understood.informs.items() <= goal.constraints.items()
        assert session.verdict is not None
        # Agents have learned with four turns; how many there are is the study's.
        farewell = session.exchanges[-1].answered.act in ("thanks", "closing")
        assert (session.ended_by == "agent") == farewell


def test_agents_that_cannot_talk_are_named_together(study, restaurant):
    agents = {"one": "shipped:nobody", "two": "nowhere", "three": "dqn"}
    terms = replace(study.terms, agents=agents)
    with pytest.raises(StudyError) as error:
        players.make_talker(replace(study, terms=terms, domain=restaurant))
    for name, fault in zip(agents, error.value.faults, strict=True):
        assert f"agent {name} " in fault


@pytest.fixture(scope="module")
def simulator(movie):
    return Simulator(tensorize(movie))


def test_a_user_says_what_it_means_in_the_simulator(movie, simulator):
    coding, active = Coding(simulator.domain), torch.ones(len(movie.slots), dtype=torch.bool)

    def frame(state, act, informs, requests):
        return coding.frame(int(state[act]), state[informs].tolist(), state[requests].tolist())

    names = list(map(str, movie.actions))
    satisfied = 0
    for number, goal in enumerate(movie.goals[:24], start=1):
        user = SimulatedUser(simulator, Letters(), number, number)
        generator = torch.Generator().manual_seed(number)
        draws = simulator.draw_reset((), generator)
        draws["goal"] = torch.tensor((number - 0.5) / len(movie.goals))
        state = simulator.reset(draws, active)
        assert int(state["goal_id"]) == number - 1
        said = None
        actions = torch.randint(len(names) - 2, (9,), generator=torch.manual_seed(number)).tolist()
        if number % 2:  # they are told all they want, so that some are satisfied
            wanted = [f"request({slot})" for slot in goal.constraints]
            wanted += [*(f"inform({slot})" for slot in goal.requests), "inform(ticket)"]
            actions = [names.index(name) for name in wanted if name in names]
        for action in (*actions, names.index("inform(taskcomplete)"), names.index("thanks")):
            assert user.say(said) == str(frame(state, "user_act", "meant_informs", "pending"))
            before = state
            state = simulator.turn(
                state, torch.tensor(action), simulator.draw_turn((), generator), active
            )
            said = frame(state, "agent_act", "agent_informs", "agent_requests")
            if bool(state["done"]):
                break
        assert not bool(before["done"])
        assert user.satisfied == bool(state["success"])
        satisfied += user.satisfied
    assert 0 < satisfied < 24


def test_a_user_who_is_asked_again_says_it_again(simulator):
    speak = Letters()
    user = SimulatedUser(simulator, speak, 1, 0)
    first = user.say(None)
    assert user.say(Frame("not_sure")) == first
    informs = Frame.parse(first).informs
    slot = next(iter(informs))
    asked = Frame("multiple_choice", {}, (slot,))
    assert user.say(asked) == str(Frame("inform", {slot: informs[slot]}))
    assert speak.question is None  # no act of the agent's that its words would answer
    assert user.say(Frame("request", {}, (slot,))) == str(Frame("inform", {slot: informs[slot]}))
    assert speak.question == Frame("request", {}, (slot,))


def test_a_user_takes_down_what_is_told_before_a_question_or_in_an_offer(movie, simulator):
    goal = next(i for i, goal in enumerate(movie.goals, 1) if len(goal.requests) == 1)
    (slot,) = movie.goals[goal - 1].requests
    value = next(record[slot] for record in movie.records if slot in record)
    for said in (
        Frame("request", {slot: value}, ("actor",)),
        Frame("inform", {slot: value, "taskcomplete": "ticket available"}),
    ):
        user = SimulatedUser(simulator, Letters(), goal, 0)
        assert slot in Frame.parse(user.say(None)).requests
        later = [Frame.parse(user.say(act)) for act in (said, *[Frame("confirm_answer")] * 9)]
        assert all(slot not in frame.requests for frame in later)
