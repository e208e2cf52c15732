"""The recipes of Table 1 and of the ablations are what their reports compare."""

from dataclasses import asdict

import pytest
from result_folders import sweeps

from bbq_torchrl.evaluation.compare_runs import PAPER
from bbq_torchrl.evaluation.finished_runs import agent_name
from bbq_torchrl.options.registry import options
from bbq_torchrl.runs.compose import compose


@pytest.mark.parametrize(
    ("setting", "env", "rounds"),
    [("table1_full", "full", 150), ("table1_extension", "domain_ext", 200)],
)
def test_every_cell_of_table1_has_a_recipe(setting, env, rounds):
    recipes = {name.removeprefix("agents/") for name in options("experiment")}
    assert {name.replace("-", "_").lower() for name in PAPER[env]} <= recipes
    config = compose([f"+experiment=[agents/dqn_vime_mc,{setting}]"])
    assert (config.env.name, config.protocol.rounds, config.replicas) == (env, rounds, 5)
    assert agent_name(asdict(config)) == "DQN-VIME-MC"
    assert all(0 < rate < 1 for rate, _ in PAPER[env].values())


def test_every_ablation_changes_one_key_of_the_reference():
    reference = asdict(compose(["+experiment=ablations/reference"]))
    last = {name: overrides for name, overrides in sweeps("ablations") if overrides}
    assert last
    for name, (override,) in last.items():
        group, key = override.partition("=")[0].split(".")
        config = asdict(compose([f"+experiment={name}", override]))
        assert config[group][key] != reference[group][key]
        assert config | {group: config[group] | {key: reference[group][key]}} == reference
