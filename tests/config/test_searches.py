"""What a search's command line stands for, and what is refused before a trial runs."""

from __future__ import annotations

import shlex

import pytest

from bbq_torchrl.cli.parameters import parse_parameter
from bbq_torchrl.cli.searches import compose_search
from bbq_torchrl.cli.store import options
from bbq_torchrl.options import ConfigError

FLOAT = {"type": "float", "low": 0.1, "high": 1.0}


def test_our_searches_can_be_run_at_every_bound_and_vary_what_each_agent_has():
    searches = {name: compose_search([f"search={name}"]) for name in options("search")}
    spaces = {name: {*found.space} for name, found in searches.items()}
    assert all(spaces.values())
    assert all(found.folder.name == f"search_{name}" for name, found in searches.items())
    assert spaces["bbqn"] == {
        "agent.mean_init",
        "agent.std_init",
        "agent.prior_std",
        "agent.kl_temperature",
    }
    assert "explore.temperature_init" in spaces["dqn_boltzmann"]
    assert "agent.prior_std" not in spaces["dqn_boltzmann"]


def test_a_temperature_that_is_searched_stays_the_same_over_all_rounds():
    config = compose_search(["search=dqn_boltzmann"]).config({"explore.temperature_init": 0.7})
    assert (config.explore.temperature_init, config.explore.temperature_end) == (0.7, 0.7)


def test_the_command_line_changes_settings_space_and_what_is_fixed():
    search = compose_search(
        [
            "search=bbqn",
            "search.trials=7",
            "search.objective=final",
            "search.space.agent.prior_std.high=.5",
            "search.space.agent.mean_init=null",
            "search.space.agent.std_init=null",
            "search.space.agent.kl_temperature=null",
            "search.space.agent.target={type: categorical, choices: [map, mc]}",
            "agent.lr=2e-3",
            "replicas=3",
        ]
    )
    assert (search.settings.trials, search.settings.objective) == (7, "final")
    assert {name: item.probes for name, item in search.space.items()} == {
        "agent.prior_std": [0.03, 0.5],
        "agent.target": ["map", "mc"],
    }
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
        "  protocol.batch_size: {type: int, low: 16, high: 64, step: 16}\n"
        "  agent.dropout: {type: categorical, choices: [0, 0.5]}\n"
    )
    search = compose_search([f"search={file}"])
    assert search.name == "mine"
    assert search.settings.trials == 4
    assert search.space["agent.lr"].low == 1e-4
    values = {"agent.lr": 1e-3, "protocol.batch_size": 48, "agent.dropout": 0}
    config = search.config(values)
    assert (config.agent.lr, config.protocol.batch_size, config.agent.dropout) == (1e-3, 48, 0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "search must be given once, as one of bbqn, bootstrap, dqn"),
        (
            "search=nope",
            "dqn, dqn_boltzmann, vime or a YAML file, got 'nope'",
        ),
        ("search=nowhere.yaml", "nowhere.yaml cannot be read"),
        ("search=bbqn search.trails=3", "search.trails is not a key; there are folder, trials"),
        (
            "search=dqn seed=1,2",
            "several values: in a search write search.space.seed={type: categorical, choices",
        ),
        ("search=dqn --multirun", "'--multirun' cannot be read: write key=value"),
        ("search=dqn search.folder=${nope}", "'search.folder=${nope}' cannot be read"),
        ("search=bbqn search.trials=0", "search.trials must be an integer from 1 to 10**9, got 0"),
        ("search=bbqn search.trials=many", "search.trials must be an integer from 1 to 10**9"),
        ("search=bbqn search.objective=best", "search.objective must be one of training, final"),
        ("search=bbqn agent.priorstd=1", "did you mean agent.prior_std?"),
        ("search=bbqn agent=dqn", "agent.mean_init is not a key"),
        ("search=dqn replicas=0", "replicas must be an integer from 1 to 1000, got 0"),
        ("search=dqn resume=runs/x", "resume=runs/x cannot be part of a search"),
        ("search=dqn hydra/launcher=cores", "hydra/launcher=cores cannot be part of a search"),
        ("search=dqn search.space.explore.eps_init.low=0", "explore.eps_init.low must be positive"),
        ("search=dqn search.space.explore.eps_init.hihg=1", "explore.eps_init.hihg is not a key"),
        ("search=dqn search.space.agent.gamma.high=1", "agent.gamma does not vary"),
        ("search=dqn search.space.agent.gamma=null", "search.space.agent.gamma does not vary"),
        ("search=dqn search.space.explore.eps_init.high=1.5", "explore.eps_init must be a number"),
        (
            "search=vime intrinsic.eta=1 intrinsic.weights=mc",
            "search.space must have a key that varies",
        ),
        (
            "search=dqn 'search.space.agent.gama={type: float, low: 0, high: 1}'",
            "did you mean agent.gamma?",
        ),
    ],
)
def test_a_search_that_cannot_be_run_is_refused_by_name(arguments, message):
    with pytest.raises(ConfigError) as refused:
        compose_search(shlex.split(arguments))
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (3, "space.agent.lr must be a mapping such as {type: float, low: 0, high: 1}, got 3"),
        (
            {"type": "real"},
            "space.agent.lr.type must be one of float, int, categorical, got 'real'",
        ),
        ({"type": "float", "low": 0.1}, "space.agent.lr.high must be given: it must be a number"),
        ({**FLOAT, "low": 1.0}, "space.agent.lr.low must be below"),
        ({**FLOAT, "log": "yes"}, "space.agent.lr.log must be true or false, got 'yes'"),
        ({**FLOAT, "step": 0.0}, "space.agent.lr.step must be positive"),
        ({**FLOAT, "choices": [1]}, "space.agent.lr.choices is not a key; there are low, high"),
        ({"type": "int", "low": 0.5, "high": 2}, "space.agent.lr.low must be an integer, got 0.5"),
        ({"type": "categorical", "choices": []}, "space.agent.lr.choices must be a list of values"),
    ],
)
def test_an_entry_of_the_space_that_means_nothing_is_refused(entry, message):
    with pytest.raises(ConfigError) as refused:
        parse_parameter("space.agent.lr", entry)
    assert message in str(refused.value)
