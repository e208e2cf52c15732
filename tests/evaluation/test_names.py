"""The names of agents are the paper's."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from bbq_torchrl.cli.store import compose
from bbq_torchrl.evaluation.names import agent_name

NAMES = {
    "agents/dqn": "DQN",
    "agents/dqn_boltzmann": "DQN-Boltzmann",
    "agents/dqn_bootstrap": "DQN-Bootstrap",
    "agents/dqn_vime_map": "DQN-VIME-MAP",
    "agents/dqn_vime_mc": "DQN-VIME-MC",
    "agents/bbqn_map": "BBQN-MAP",
    "agents/bbqn_mc": "BBQN-MC",
    "agents/bbqn_vime_map": "BBQN-VIME-MAP",
    "agents/bbqn_vime_mc": "BBQN-VIME-MC",
    "baselines/double_dqn": "Double DQN",
    "baselines/noisy_dqn": "Noisy DQN",
}


@pytest.mark.parametrize("recipe", NAMES)
def test_a_recipe_has_the_name_that_the_paper_gives_its_agent(recipe):
    assert agent_name(asdict(compose([f"+experiment={recipe}"]))) == NAMES[recipe]


def test_targets_and_gains_that_differ_are_both_named():
    config = compose(["agent.target=mc", "intrinsic=vime", "intrinsic.weights=map"])
    assert agent_name(asdict(config)) == "BBQN-MC-VIME-MAP"


def test_a_configuration_of_an_earlier_version_is_named_too():
    assert agent_name({"agent": {"name": "bbqn", "target": "map"}}) == "BBQN-MAP"


@pytest.mark.parametrize(
    ("config", "name"),
    [
        ({"agent": {"name": "polyak", "target": 0.005, "noisy": 0.1}}, "POLYAK"),
        ({"agent": {"name": "lnq", "double": True}, "explore": {"name": "boltzmann"}}, "LNQ"),
        ({"agent": {"name": "lnq"}, "intrinsic": {"name": "none"}}, "LNQ"),
        ({"agent": {"name": "lnq"}, "intrinsic": {"name": "vime", "weights": "mc"}}, "LNQ-VIME-MC"),
        ({"agent": {"name": "dqn"}, "intrinsic": {"name": "novelty"}}, "DQN-NOVELTY"),
        (
            {
                "agent": {"name": "bbqn", "target": "mc"},
                "intrinsic": {"name": "novelty", "weights": "mc"},
            },
            "BBQN-MC-NOVELTY",
        ),
    ],
)
def test_keys_of_options_of_ones_own_are_no_part_of_a_name(config, name):
    assert agent_name(config) == name
