"""What the agent sees, and where."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.simulator import FeatureLayout

from .scenes import ACTS, SLOTS, Scene


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


def test_the_first_state_shows_the_users_act_and_what_matches_it():
    scene = Scene({"city": "boston", "date": "today"}, ("theater",))
    state = scene.start(constraint="city")
    matches = {f"kb_match:{slot}": 1 for slot in (*SLOTS, "all")}
    counts = {f"kb_count:{slot}": 0.02 for slot in (*SLOTS, "all")}
    assert seen(scene, state) == {
        "user_act:request": 1,
        "user_informed:city": 1,
        "user_requested:theater": 1,
        "filled:city": 1,
        "turn:scaled": 0.1,
        "turn_onehot:1": 1,
        **matches,
        **counts,
    }


def test_a_later_state_shows_both_sides_and_literal_counts_of_what_is_held():
    scene = Scene({"city": "boston", "date": "today"}, ("theater",), intent_error_prob=0.5)
    before = scene.start(constraint="city")
    deny = ACTS.index("deny") / len(ACTS) + 0.01
    state = scene.say(before, "inform(theater)", agenda="date", intent=0.1, intent_act=deny)
    assert scene.values(state["held"]) == {"city": "boston", "date": "today", "theater": "odeon"}
    rest = {"movie", "genre", "people", "ticket", "done", "all"}
    assert seen(scene, state) == {
        "user_act:deny": 1,
        "user_informed:date": 1,
        "user_requested:ticket": 1,
        "agent_act:inform": 1,
        "agent_informed:theater": 1,
        **{f"filled:{slot}": 1 for slot in ("city", "date", "theater")},
        "turn:scaled": 0.3,
        "turn_onehot:3": 1,
        **{f"kb_match:{slot}": 1 for slot in rest | {"city", "date", "theater"}},
        **{f"kb_count:{slot}": 0.01 for slot in rest},
        **{f"kb_count:{slot}": 0.02 for slot in ("city", "date", "theater")},
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


def test_nothing_matches_where_no_match_is_held():
    scene = Scene({})
    features = seen(scene, scene.situation(held={"genre": "no match", "city": "boston"}))
    assert {name for name in features if name.startswith("kb_")} == {
        "kb_match:city",
        "kb_count:city",
    }


def test_the_agents_request_is_seen():
    scene = Scene({"city": "boston"})
    features = seen(scene, scene.say(scene.start(), "request(date)"))
    assert features["agent_act:request"] == features["agent_requested:date"] == 1


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
