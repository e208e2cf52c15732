"""The configurations of searches, and refusals before a trial runs."""

import pytest
import yaml

from bbq_torchrl.options.registry import conf_folder, options
from bbq_torchrl.search.definition import compose_search

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


def test_a_search_can_be_anybodys_yaml_file(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "fixed: [agent=dqn]\n"
        "trials: 4\n"
        "space:\n"
        "  agent.lr: {type: float, low: 1e-4, high: 1e-2, log: true}\n"
        "  agent.dropout: {type: categorical, choices: [0, 0.5]}\n"
    )
    search = compose_search([f"search={file}"])
    assert (search.name, search.settings.trials) == ("mine", 4)
    config = search.config({"agent.lr": 1e-3, "agent.dropout": 0})
    assert (config.agent.lr, config.agent.dropout) == (1e-3, 0)
