"""The configurations of command lines, those of searches too."""

from dataclasses import asdict

import pytest
import yaml
from tiny import composed, nightly

from bbq_torchrl.evaluation.finished_runs import agent_name
from bbq_torchrl.options import registry
from bbq_torchrl.options.registry import conf_folder, options
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.search.definition import compose_search
from bbq_torchrl.settings import ConfigError

RECIPES = {
    "agents/dqn": "DQN",
    "agents/dqn_boltzmann": "DQN-Boltzmann",
    "agents/dqn_bootstrap": "DQN-Bootstrap",
    "agents/dqn_vime_map": "DQN-VIME-MAP",
    "agents/dqn_vime_mc": "DQN-VIME-MC",
    "agents/bbqn_map": "BBQN-MAP",
    "agents/bbqn_map_soft": "Soft BBQN-MAP",
    "agents/bbqn_mc": "BBQN-MC",
    "agents/bbqn_vime_map": "BBQN-VIME-MAP",
    "agents/bbqn_vime_mc": "BBQN-VIME-MC",
    "agents/double_dqn": "Double DQN",
    "agents/noisy_dqn": "Noisy DQN",
}
"""The paper's names, which tell network, exploration, target and intrinsic reward."""


@pytest.mark.parametrize(
    "recipe", nightly(RECIPES, ["agents/bbqn_mc", "agents/dqn_bootstrap", "agents/noisy_dqn"])
)
def test_a_recipe_composes_the_agent_that_the_paper_gives_its_name(recipe):
    config = compose([f"+experiment={recipe}", "env=domain_ext"])
    assert agent_name(asdict(config)) == RECIPES[recipe]
    assert (config.env.name, config.protocol.rounds) == ("domain_ext", 200)


def test_what_follows_another_key_does_so_unless_given():
    config = compose(["agent=dqn", "env=domain_ext", "protocol.lr=2e-3"])
    assert (config.protocol.rounds, config.agent.lr) == (200, 2e-3)
    config = compose(["protocol=quick", "env=domain_ext", "agent.lr=.1"])
    assert (config.protocol.rounds, config.protocol.lr, config.agent.lr) == (40, 2e-3, 0.1)


def test_numbers_can_be_environment_variables(monkeypatch):
    monkeypatch.setenv("RATE", "2e-3")
    config = compose(["agent.lr=[.1,'${oc.env:RATE}']", "protocol.lr=${oc.env:RATE}", "replicas=2"])
    assert (config.agent.lr, config.protocol.lr) == ([0.1, 0.002], 0.002)


@pytest.mark.parametrize(
    "override", ["agent.lr=[.1,'{}']", "agent.target={}", "replicas={}", "protocol.lr={}"]
)
def test_a_message_shows_a_reference_and_not_its_value(override, monkeypatch):
    monkeypatch.setenv("TOKEN", "se'cret" * 100)
    with pytest.raises(ConfigError) as error:
        compose(["agent=bbqn", override.format("${oc.env:TOKEN}")])
    assert override.partition("=")[0] in str(error.value)
    assert "${oc.env:TOKEN}" in str(error.value)
    assert "cret" not in str(error.value)


BEYOND_AGENTS = [n for n in options("experiment") if "/" not in n and n != "paper_start"]


@pytest.mark.parametrize("experiment", nightly(BEYOND_AGENTS, ["tcbot", "table1_full"]))
def test_an_experiment_leaves_the_agent_to_the_command_line(experiment):
    files = ["domain.path=corpus"] if experiment == "tcbot" else []
    config = compose([f"+experiment={experiment}", "agent=bootstrap", "protocol.rounds=7", *files])
    assert (config.agent.name, config.explore.name) == ("bootstrap", "bootstrap")
    assert config.protocol.rounds == 7


def test_an_experiment_of_a_folder_decides_over_groups_and_keys(tmp_path, monkeypatch):
    monkeypatch.setenv(registry.FOLDER_VARIABLE, str(tmp_path))
    (tmp_path / "experiment" / "agents").mkdir(parents=True)
    (tmp_path / "experiment" / "agents" / "warm.yaml").write_text(
        "# @package _global_\n"
        "defaults: [override /agent: dqn, override /explore: boltzmann]\n"
        "agent:\n  lr: 0.5\n"
    )
    assert "agents/warm" in options("experiment")
    config = compose(["+experiment=agents/warm"])
    assert (config.agent.name, config.explore.name, config.agent.lr) == ("dqn", "boltzmann", 0.5)
    assert compose(["+experiment=agents/warm", "agent.lr=.1"]).agent.lr == 0.1


def test_the_edges_of_what_fits_together_are_composed():
    assert composed("agent=gp", "protocol.capacity=512").protocol.capacity == 512
    assert composed("protocol=quick", "agent=gp").protocol.capacity == 40_000
    composed("protocol.capacity=32", "explore.temperature_end=.7")
    composed("agent=bootstrap", "agent.trunk_layers=2", "replicas=4", "agent.lr=[.1,.2]")


LEARNER = {f"protocol.{key}" for key in ("lr", "epochs", "batch_size")}
VARIED = {
    "bbqn": {"agent.std_init", "agent.prior_std", "agent.kl_temperature"},
    "dqn_boltzmann": {"explore.temperature_init"},
}


@pytest.mark.slow  # daily, the example of compose_search
@pytest.mark.parametrize("name", options("search"))
def test_our_search_can_be_run_at_every_bound_and_varies_what_its_agent_has(name):
    found = compose_search([f"search={name}"])
    assert found.folder.name == f"search_{name}"
    assert LEARNER | VARIED.get(name, set()) <= {*found.space}
    assert ("agent.prior_std" in found.space) == (name == "bbqn")


def test_the_command_line_changes_settings_space_and_what_is_fixed():
    given = ["search=bbqn", "search.trials=7", "search.objective=final", "agent.lr=2e-3"]
    searched = yaml.safe_load((conf_folder() / "search" / "bbqn.yaml").read_text())["space"]
    given += [f"search.space.{key}=null" for key in searched if key != "agent.prior_std"]
    given.append("search.space.agent.target={type: categorical, choices: [map, mc]}")
    search = compose_search([*given, "search.space.agent.prior_std.high=.5", "replicas=3"])
    assert (search.settings.trials, search.settings.objective) == (7, "final")
    assert search.space["agent.prior_std"] == {**searched["agent.prior_std"], "high": 0.5}
    assert search.space["agent.target"]["choices"] == ["map", "mc"]
    config = search.config({"agent.prior_std": 0.25, "agent.target": "mc"})
    assert (config.agent.lr, config.agent.prior_std, config.agent.target) == (2e-3, 0.25, "mc")
    assert config.replicas == 3
    assert search.fixed.count("replicas=3") == 1  # the file has it too
