"""How often errors are, and what they leave alone; what they do is spelled on the oracle."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.simulator import ErrorModel

from .scenes import ACTS, NEVER, SLOTS, Scene, cinema


def test_slots_are_hit_as_often_as_the_probability_says():
    domain = tensorize(cinema(Goal({"city": "boston"})))
    count, prob = 200_000, 0.3
    model = ErrorModel(domain, prob, "delete")
    generator = torch.Generator().manual_seed(1)
    draws = TensorDict(
        {"error": torch.rand(count, len(SLOTS), generator=generator)}, batch_size=[count]
    )
    sent = model.distort(
        torch.ones(count, len(SLOTS), dtype=torch.long), draws, torch.ones(len(SLOTS)).bool()
    )
    share = (sent == 0).double().mean(0)
    assert (share - prob).abs().max() < 5 * (prob * (1 - prob) / count) ** 0.5


def test_nothing_is_misheard_when_the_dialogue_ends():
    scene = Scene({"city": "boston"}, intent_error_prob=1.0, slot_error_prob=1.0)
    state = scene.say(scene.start(), "thanks", intent=0.0, intent_act=0.0, error=0.0)
    assert ACTS[int(state["heard_act"])] == "closing"


def test_an_error_reaches_tracker_and_history_but_never_the_goal():
    scene = Scene({"city": "boston"}, slot_error_prob=0.5)
    before = scene.situation(agenda=("city", "ticket"))
    state = scene.say(before, "request(city)", error=0.0, error_value=NEVER)
    assert scene.values(state["meant_informs"]) == {"city": "boston"}
    assert scene.values(state["user_informs"]) == {"city": "austin"}
    assert scene.values(state["held"]) == {"city": "austin"}
    assert scene.values(state["constraints"]) == {"city": "boston"}
    later = scene.say(state, "greeting")
    assert scene.values(later["history"]) == {"city": "austin"}
    asked_again = scene.say(later, "request(city)", "greeting")
    assert scene.values(asked_again["history"]) == {"city": "boston"}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"slot_error_prob": 1.5}, "slot_error_prob must be a probability .* got 1.5"),
        ({"intent_error_prob": -0.1}, "intent_error_prob must be a probability .* got -0.1"),
        ({"slot_error_prob": float("nan")}, "slot_error_prob must be a probability .* got nan"),
        ({"slot_error_mode": "typo"}, "slot_error_mode must be one of value, slot.* got 'typo'"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        ErrorModel(tensorize(cinema(Goal({}))), **settings)
