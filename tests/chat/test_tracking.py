"""What an agent sees in a chat is what it would see in the simulator."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.chat.tracking import Tracking
from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.coding import Coding
from bbq_torchrl.language import Frame
from bbq_torchrl.simulator import ErrorModel, Simulator

PLACES = 8


class Played:
    """Simulated dialogues with the frames that a person would have said in them."""

    def __init__(self, domain, errors, seed=0):
        self.tensors = tensorize(domain)
        self.simulator = Simulator(self.tensors, errors=ErrorModel(self.tensors, errors))
        self.active = torch.ones(self.tensors.n_slots, dtype=torch.bool)
        generator = torch.Generator().manual_seed(seed)
        state = self.simulator.reset(self.simulator.draw_reset((PLACES,), generator), self.active)
        self.states, self.actions = [state], []
        ends = torch.tensor([action.act in ("thanks", "closing") for action in domain.actions])
        while not bool(state["done"].all()):
            action = torch.randint(self.tensors.n_actions, (PLACES,), generator=generator)
            early = ends[action] & (torch.rand(PLACES, generator=generator) < 0.9)
            action = torch.where(early, domain.action_index("inform(taskcomplete)"), action)
            draws = self.simulator.draw_turn((PLACES,), generator)
            state = self.simulator.turn(state, action, draws, self.active)
            self.states.append(state)
            self.actions.append(action)

    def frame(self, state):
        informs, requests = state["user_informs"].tolist(), state["heard_requests"].tolist()
        return Coding(self.tensors).frame(int(state["heard_act"]), informs, requests)


def together(played, place):
    """Yields the simulator's state and the tracking's, turn by turn until the dialogue ends."""
    tracking = Tracking(played.simulator, played.active)
    for number, states in enumerate(played.states):
        state = states[place]
        if bool(state["done"]):
            return
        heard = played.frame(state)
        if number == 0:
            tracked = tracking.start(heard)
        else:
            tracked = tracking.act(tracked, int(played.actions[number - 1][place]))
            tracked = tracking.hear(tracked, heard)
        yield state, tracked, tracking


@pytest.mark.parametrize("errors", [0.0, 0.3])
def test_an_agent_sees_bit_for_bit_what_it_sees_in_the_simulator(movie, errors):
    played = Played(movie, errors)
    turns = 0
    for place in range(PLACES):
        for state, tracked, tracking in together(played, place):
            expected = played.simulator.observe(state, played.active)
            assert torch.equal(tracking.observe(tracked), expected)
            turns += 1
    assert turns > 5 * PLACES


def test_a_question_is_kept_while_the_person_answers_and_shown_again_after(movie):
    played = Played(movie, 0.0)
    tracking = Tracking(played.simulator, played.active)
    theater = movie.slots.index("theater")
    state = tracking.start(Frame("request", {"moviename": "wonka"}, ("theater",)))
    state = tracking.act(state, movie.action_index("request(city)"))
    state = tracking.hear(state, Frame("inform", {"city": "seattle"}))
    assert not state["heard_requests"][theater]
    assert state["open_requests"][theater]
    state = tracking.act(state, movie.action_index("inform(date)"))
    state = tracking.hear(state, Frame("confirm_answer"))
    assert state["heard_requests"][theater]
    state = tracking.act(state, movie.action_index("inform(theater)"))
    assert not state["heard_requests"].any()
    assert not state["open_requests"].any()
