"""The layout of the features."""

import pytest

from bbq_torchrl.domains import tensorize
from bbq_torchrl.simulator import FeatureLayout


@pytest.fixture
def layout(movie):
    return FeatureLayout(tensorize(movie))


def test_the_layout_of_the_movies_has_the_papers_268_features(layout):
    of_slots = ("user_informed", "user_requested", "agent_informed", "agent_requested", "filled")
    widths = {"user_act": 11, "agent_act": 11, **dict.fromkeys(of_slots, 29)}
    widths |= {"turn": 1, "turn_onehot": 40, "kb_match": 30, "kb_count": 30}
    assert {name: layout[name].stop - layout[name].start for name in layout} == widths
    assert layout.size == len({*layout.names}) == 268
    members = [(group, member) for group, names in layout.groups.items() for member in names]
    assert [layout.column(*member) for member in members] == list(range(268))
    assert layout.names == tuple(":".join(member) for member in members)


def test_an_unknown_feature_is_refused(layout):
    with pytest.raises(KeyError, match="user"):
        layout["user"]
    with pytest.raises(KeyError, match="filled:cinema"):
        layout.column("filled", "cinema")
