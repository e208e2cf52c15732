"""What the agent sees, and where."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.simulator import FeatureLayout

from .scenes import Scene


def seen(scene, state):
    """Returns the features that are not 0, by group and member."""
    layout = scene.simulator.layout
    features = scene.simulator.observe(state, scene.active)
    assert features.dtype == torch.float32
    return {
        name: pytest.approx(value)
        for name, value in zip(layout.names, features.tolist(), strict=True)
        if value
    }


def test_reserved_values_and_free_slots_count_no_record():
    scene = Scene({})
    state = scene.situation(held={"city": "I do not care", "people": "9", "ticket": "no match"})
    features = seen(scene, state)
    for slot in ("city", "people", "ticket"):
        assert features[f"filled:{slot}"] == 1
        assert f"kb_count:{slot}" not in features
        assert f"kb_match:{slot}" not in features
    assert features["kb_count:all"] == 0.04


def test_slots_that_are_not_active_are_seen_nowhere():
    active = ("movie", "people", "ticket", "done")
    scene = Scene({"movie": "deadpool", "city": "boston"}, ("theater",), active=active)
    for state in (scene.start(), scene.say(scene.start(), "inform(movie)")):
        about = {name.partition(":")[2] for name in seen(scene, state)}
        assert not about & {"city", "date", "theater", "genre"}


def test_the_turn_is_clamped_at_the_end_of_its_one_hot():
    scene = Scene({"city": "boston"})
    assert seen(scene, scene.situation(turn=6))["turn_onehot:7"] == 1
    late = seen(scene, scene.situation(turn=10))
    assert late["turn_onehot:7"] == 1
    assert late["turn:scaled"] == 1.1


def test_the_layout_of_the_movies_has_the_papers_268_features(movie):
    domain = tensorize(movie)
    layout = FeatureLayout(domain)
    assert layout.size == len(layout.names) == 268
    assert len(set(layout.names)) == 268
    widths = {name: layout[name].stop - layout[name].start for name in layout}
    assert widths == {
        "user_act": 11,
        "user_informed": 29,
        "user_requested": 29,
        "agent_act": 11,
        "agent_informed": 29,
        "agent_requested": 29,
        "filled": 29,
        "turn": 1,
        "turn_onehot": 40,
        "kb_match": 30,
        "kb_count": 30,
    }
    ends = [layout[name].stop for name in layout]
    assert [layout[name].start for name in layout] == [0, *ends[:-1]]
    for group in layout.groups:
        for position, member in enumerate(group.members):
            column = layout.column(group.name, member)
            assert column == layout[group.name].start + position
            assert layout.names[column] == f"{group.name}:{member}"


def test_an_unknown_feature_is_refused(movie):
    layout = FeatureLayout(tensorize(movie))
    with pytest.raises(KeyError, match="'user' is no group of features; there are user_act, "):
        layout["user"]
    with pytest.raises(KeyError, match="'cinema' is no feature of 'filled', which has actor, "):
        layout.column("filled", "cinema")
