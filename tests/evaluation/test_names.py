"""Agents are called as the paper calls them; tests/config has the names of the recipes."""

from __future__ import annotations

import pytest

from bbq_torchrl.evaluation.finished_runs import agent_name


@pytest.mark.parametrize(
    ("agent", "others", "name"),
    [
        # of an earlier version, without the groups that it did not have yet
        ({"name": "bbqn", "target": "map"}, {}, "BBQN-MAP"),
        # a target and a gain that differ are both named
        ({"name": "bbqn", "target": "mc"}, {"name": "vime", "weights": "map"}, "BBQN-MC-VIME-MAP"),
        # keys of options of one's own are no part of a name
        ({"name": "polyak", "target": 0.005, "noisy": 0.1}, {}, "POLYAK"),
        ({"name": "lnq", "double": True}, {"name": "none"}, "LNQ"),
        ({"name": "lnq"}, {"name": "vime", "weights": "mc"}, "LNQ-VIME-MC"),
        ({"name": "dqn"}, {"name": "novelty"}, "DQN-NOVELTY"),
        ({"name": "bbqn", "target": "mc"}, {"name": "novelty", "weights": "mc"}, "BBQN-MC-NOVELTY"),
    ],
)
def test_an_agent_is_named_by_the_keys_that_the_paper_has(agent, others, name):
    assert agent_name({"agent": agent} | ({"intrinsic": others} if others else {})) == name


def test_an_option_of_ones_own_is_named_whatever_explores():
    assert agent_name({"agent": {"name": "lnq"}, "explore": {"name": "boltzmann"}}) == "LNQ"
