"""Readable transcripts of dialogues."""

import torch
from oracle.small import CINEMA, SLOTS, draws, small_domain
from tensordict import TensorDict

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.simulator import ErrorModel, Simulator, Transcript
from bbq_torchrl.simulator.measured_errors import load_errors

GOAL = Goal({"city": "boston", "date": "today"}, ("theater",))
ACTIVE = torch.ones(len(SLOTS), dtype=torch.bool)


class Scene:
    """A user of the small cinema whose acts may be misheard, and the transcript."""

    def __init__(self, **first):
        domain = tensorize(small_domain(GOAL))
        errors = ErrorModel(domain, slot_error_prob=0.5, intent_error_prob=0.5)
        self.simulator, self.transcript = Simulator(domain, errors=errors), Transcript(domain)
        self.state = self.simulator.reset(TensorDict(draws(**first)), ACTIVE)

    def say(self, action, **chosen):
        index, drawn = torch.tensor(CINEMA.action_index(action)), TensorDict(draws(**chosen))
        self.state = self.simulator.turn(self.state, index, drawn, ACTIVE)
        return self.lines()

    def lines(self):
        return self.transcript.lines(self.state)


def test_a_dialogue_reads_as_acts_with_slots_and_values():
    scene = Scene(constraint="city")
    assert scene.lines() == ["user: request(theater) inform(city=boston)"]
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


def test_what_was_misheard_is_shown_beside_what_was_meant():
    scene = Scene(constraint="date")
    deny = CINEMA.acts.index("deny") / len(CINEMA.acts) + 0.01
    _, user = scene.say("request(city)", error=0.0, intent=0.0, intent_act=deny)
    assert user == "user: inform(city=boston) [heard: deny inform(city=seattle)]"


def test_a_question_that_was_not_heard_is_not_shown_as_heard():
    scene = Scene(constraint="city")
    scene.state["heard_requests"] = ~ACTIVE
    said, heard = "request(theater) inform(city=boston)", "request inform(city=boston)"
    assert scene.lines() == [f"user: {said} [heard: {heard}]"]


def test_a_question_left_open_is_not_misheard_at_the_end(movie):
    simulator = Simulator(tensorize(movie), errors=load_errors(movie))
    active = torch.ones(len(movie.slots), dtype=torch.bool)
    state = simulator.reset(simulator.draw_reset((1_000,)), active)
    thanks = torch.full((1_000,), movie.action_index("thanks"))
    state = simulator.turn(state, thanks, simulator.draw_turn((1_000,)), active)
    assert (state["pending"] != state["heard_requests"]).any()
    lines = [Transcript(simulator.domain).user(one) for one in state]
    assert all(line.startswith("closing") and "heard" not in line for line in lines)
