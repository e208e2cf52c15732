"""What the agent sees, and where."""

from __future__ import annotations

import pytest

from bbq_torchrl.domains import tensorize
from bbq_torchrl.simulator import FeatureLayout


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
