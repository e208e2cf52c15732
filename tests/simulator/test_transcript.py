"""Dialogues as people read them."""

from __future__ import annotations

import pytest
import torch
from oracle.small import ACTS, SLOTS, draws, small_domain
from tensordict import TensorDict

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.envs.measured import load_errors
from bbq_torchrl.simulator import ErrorModel, Simulator, Transcript

GOAL = Goal({"city": "boston", "date": "today"}, ("theater",))


class Scene:
    """One user of the small cinema whose every act may be misheard, and how it reads."""

    def __init__(self):
        domain = tensorize(small_domain(GOAL))
        errors = ErrorModel(domain, slot_error_prob=0.5, intent_error_prob=0.5)
        self.simulator = Simulator(domain, errors=errors)
        self.transcript = Transcript(domain)
        self.active = torch.ones(len(SLOTS), dtype=torch.bool)
        self.actions = [str(action) for action in small_domain(GOAL).actions]

    def start(self, **chosen):
        self.state = self.simulator.reset(self._draws(chosen), self.active)
        return self.transcript.lines(self.state)

    def say(self, action, **chosen):
        index, drawn = torch.tensor(self.actions.index(action)), self._draws(chosen)
        self.state = self.simulator.turn(self.state, index, drawn, self.active)
        return self.transcript.lines(self.state)

    @staticmethod
    def _draws(chosen):
        return TensorDict({key: torch.tensor(value) for key, value in draws(**chosen).items()}, [])


@pytest.fixture
def scene():
    return Scene()


def test_a_dialogue_reads_as_acts_with_slots_and_values(scene):
    assert scene.start(constraint="city") == ["user: request(theater) inform(city=boston)"]
    wishes = "request(theater, ticket) inform(city=boston, date=today)"
    assert scene.transcript.goal(scene.state) == wishes
    assert scene.say("request(date)") == ["agent: request(date)", "user: inform(date=today)"]
    assert scene.say("inform(taskcomplete)") == [
        "agent: inform(city=boston, date=today, taskcomplete=ticket available)",
        "user: thanks",
    ]
    told = ["agent: inform(theater=Lux)", "user: request(ticket)"]
    assert scene.say("inform(theater)") == told
    assert scene.say("thanks") == ["agent: thanks", "user: closing request(ticket)"]


def test_the_act_comes_before_what_belongs_to_another(scene):
    scene.start(constraint="date")
    _, corrected = scene.say("inform(city)")  # most of today's showings are in Seattle
    assert corrected == "user: inform(city=boston) request(theater)"
    assert scene.say("greeting")[1] == "user: inform request(theater)"


def test_what_was_misheard_is_shown_beside_what_was_meant(scene):
    scene.start(constraint="date")
    deny = ACTS.index("deny") / len(ACTS) + 0.01
    _, user = scene.say("request(city)", error=0.0, intent=0.0, intent_act=deny)
    assert user == "user: inform(city=boston) [heard: deny inform(city=seattle)]"


def test_a_question_that_was_not_heard_is_not_shown_as_heard(scene):
    scene.start(constraint="city")
    scene.state["heard_requests"] = torch.zeros_like(scene.state["heard_requests"])
    said = "request(theater) inform(city=boston)"
    heard = "request inform(city=boston)"
    assert scene.transcript.user(scene.state) == f"{said} [heard: {heard}]"


def test_a_question_left_open_is_not_misheard_at_the_end(movie):
    simulator = Simulator(tensorize(movie), errors=load_errors(movie))
    active = torch.ones(len(movie.slots), dtype=torch.bool)
    generator = torch.Generator().manual_seed(0)
    state = simulator.reset(simulator.draw_reset((50,), generator), active)
    thanks = torch.full((50,), movie.action_index("thanks"))
    state = simulator.turn(state, thanks, simulator.draw_turn((50,), generator), active)
    assert (state["pending"] != state["heard_requests"]).any()
    transcript = Transcript(simulator.domain)
    assert all(transcript.user(one).startswith("closing") for one in state)
    assert not any("heard" in transcript.user(one) for one in state)


def test_a_transcript_is_of_one_dialogue(scene):
    lines = scene.start()
    several = scene.state.unsqueeze(0).expand(3)
    assert scene.transcript.lines(several[1]) == lines
    with pytest.raises(ValueError, match=r"must have batch size \[\], got \[3\]"):
        scene.transcript.lines(several)
