"""What errors do to the user's acts: by hand, and how often."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.domains import Goal, tensorize
from bbq_torchrl.simulator import ErrorModel

from .scenes import ACTS, NEVER, SLOTS, Scene, cinema

ALL = ("movie", "city", "date", "genre")
MEANT = {"movie": "deadpool", "city": "boston", "date": "today", "genre": "I do not care"}


def distort(scene: Scene, informs=MEANT, *, hit=ALL, kind=0.0, slot=None, value=0.0):
    """Returns what is transmitted where these slots are hit, with these draws."""

    def per_slot(numbers):
        return torch.tensor([float(numbers.get(name, 0.0)) for name in SLOTS])

    draws = TensorDict(
        {
            "error": per_slot({name: 0.0 if name in hit else NEVER for name in SLOTS}),
            "error_kind": torch.full((len(SLOTS),), kind),
            "error_slot": per_slot(slot or {}),
            "error_value": torch.full((len(SLOTS),), value),
        }
    )
    ids = torch.tensor([scene.id(s, informs[s]) if s in informs else 0 for s in SLOTS])
    return scene.values(scene.simulator.errors.distort(ids, draws, scene.active))


def test_a_value_error_puts_one_of_the_slots_values_in_place_and_spares_slots_without():
    scene = Scene({}, slot_error_prob=0.5, slot_error_mode="value")
    assert distort(scene, value=0.0) == MEANT | {"city": "seattle"}
    assert distort(scene, value=NEVER) == MEANT | {
        "movie": "zootopia",
        "city": "austin",
        "date": "sunday",
    }


def test_a_slot_that_is_not_hit_is_transmitted_as_it_was_meant():
    scene = Scene({}, slot_error_prob=0.5, slot_error_mode="value")
    assert distort(scene, hit=("city",), value=NEVER) == MEANT | {"city": "austin"}
    for mode in ("value", "slot", "delete", "mixed"):
        scene = Scene({}, slot_error_prob=0.5, slot_error_mode=mode)
        assert distort(scene, hit=()) == MEANT


def test_a_delete_error_drops_the_slot():
    scene = Scene({}, slot_error_prob=0.5, slot_error_mode="delete")
    assert distort(scene, hit=("city", "genre")) == {"movie": "deadpool", "date": "today"}


def test_a_slot_error_goes_to_another_slot_that_has_values():
    scene = Scene({}, slot_error_prob=0.5, slot_error_mode="slot")
    meant = {"city": "boston"}
    assert distort(scene, meant, slot={"city": 0.0}) == {"movie": "deadpool"}
    assert distort(scene, meant, slot={"city": 0.5}) == {"date": "today"}
    # A slot without values of its own has all three to go to.
    assert distort(scene, {"genre": "I do not care"}, slot={"genre": 0.5}) == {"city": "seattle"}


def test_a_slot_error_overrides_what_was_said_of_its_slot_and_the_last_source_wins():
    scene = Scene({}, slot_error_prob=0.5, slot_error_mode="slot")
    meant = {"movie": "zootopia", "city": "boston"}
    to_movie = distort(scene, meant, hit=("city",), slot={"city": 0.0})
    assert to_movie == {"movie": "deadpool"}
    both_to_date = distort(scene, meant, slot={"movie": 0.5, "city": 0.5}, value=0.5)
    assert both_to_date == {"date": "friday"}
    # The values come from the numbers of the source slots: city's, the later one, decides.
    draws = TensorDict(
        {key: torch.zeros(len(SLOTS)) for key in ("error", "error_kind", "error_slot")}
    )
    draws["error_slot"] = torch.full((len(SLOTS),), 0.5)
    draws["error_value"] = torch.tensor([0.99 if slot == "movie" else 0.4 for slot in SLOTS])
    ids = torch.tensor([scene.id(s, meant[s]) if s in meant else 0 for s in SLOTS])
    sent = scene.simulator.errors.distort(ids, draws, scene.active)
    assert scene.values(sent) == {"date": "friday"}


def test_a_slot_error_goes_to_active_slots_only_and_deletes_where_there_is_none():
    scene = Scene({}, slot_error_prob=0.5, slot_error_mode="slot", active=("city", "date"))
    assert distort(scene, {"city": "boston"}) == {"date": "today"}
    scene = Scene({}, slot_error_prob=0.5, slot_error_mode="slot", active=("city", "theater"))
    assert distort(scene, {"city": "boston"}) == {}


@pytest.mark.parametrize(
    ("kind", "sent"),
    [
        (0.0, {"city": "seattle"}),
        (0.333, {"city": "seattle"}),
        (0.334, {"movie": "deadpool"}),
        (0.666, {"movie": "deadpool"}),
        (0.667, {}),
        (NEVER, {}),
    ],
)
def test_mixed_errors_are_of_each_kind_in_a_third_of_the_cases(kind, sent):
    scene = Scene({}, slot_error_prob=0.5, slot_error_mode="mixed")
    assert distort(scene, {"city": "boston"}, kind=kind) == sent


def test_a_mixed_value_error_spares_a_slot_without_values():
    scene = Scene({}, slot_error_prob=0.5, slot_error_mode="mixed")
    meant = {"genre": "I do not care"}
    assert distort(scene, meant, kind=0.1) == meant


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


def test_an_intent_error_changes_what_is_heard_and_not_what_the_user_repeats():
    scene = Scene({"city": "boston"}, intent_error_prob=0.5)
    before = scene.situation(agenda=("city", "ticket"))
    greeting = ACTS.index("greeting") / len(ACTS) + 0.01
    state = scene.say(before, "request(city)", intent=0.1, intent_act=greeting)
    assert ACTS[int(state["user_act"])] == "inform"
    assert ACTS[int(state["heard_act"])] == "greeting"
    repeated = scene.say(state, "greeting")
    assert ACTS[int(repeated["user_act"])] == ACTS[int(repeated["heard_act"])] == "inform"


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
