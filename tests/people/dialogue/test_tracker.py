"""An agent sees the same in a chat as in the simulator."""

import pytest
import torch
from study.simulated import Dialogues

from bbq_torchrl.domains import tensorize
from bbq_torchrl.people.dialogue.tracking import Acted, Tracking
from bbq_torchrl.people.language import Frame
from bbq_torchrl.simulator import Simulator


@pytest.mark.parametrize("errors", [0.0, 0.3])
def test_an_agent_sees_bit_for_bit_what_it_sees_in_the_simulator(movie, errors):
    played = Dialogues(movie, 8, random_share=0.9, booking_share=0.1, errors=errors)
    simulator, active = played.env.simulator, played.env.active_slots
    tracking, turns = Tracking(simulator, active), 0
    for place in range(8):
        *states, _ = played.turns(place)
        for number, state in enumerate(states):
            heard = played.heard(state)
            if number == 0:
                tracked = tracking.start(heard)
            else:
                tracked = tracking.act(tracked, int(played.actions[number - 1][place]))
                tracked = tracking.hear(tracked, heard)
            assert torch.equal(tracking.observe(tracked), simulator.observe(state, active))
        turns += len(states)
    assert turns > 5 * 8


def test_a_question_is_kept_while_the_person_answers_and_shown_again_after(movie):
    tracking = Tracking(Simulator(tensorize(movie)), torch.ones(len(movie.slots), dtype=torch.bool))
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


def test_an_answer_stays_beside_an_offer_to_whom_it_does_not_matter():
    answer = Frame("inform", {"date": "today", "city": "reno"})
    offer = Frame("inform", {"date": "I do not care", "taskcomplete": "ticket available"})
    acted = Acted(Frame("thanks"), None, ((answer, {}), (offer, {})), ())
    assert acted.answered.informs == {**answer.informs, "taskcomplete": "ticket available"}
