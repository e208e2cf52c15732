"""The configurations of command lines."""

import re
from dataclasses import asdict

import pytest
from tiny import composed, nightly

from bbq_torchrl.evaluation.finished_runs import agent_name
from bbq_torchrl.options import explorations, registry
from bbq_torchrl.options.registry import options
from bbq_torchrl.options.task import replica_values
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.folders import load_config, save_config
from bbq_torchrl.settings import ConfigError

RECIPES = {  # the paper's name, network, exploration, target, intrinsic reward
    "agents/dqn": ("DQN", "dqn", "epsilon_greedy", None, None),
    "agents/dqn_boltzmann": ("DQN-Boltzmann", "dqn", "boltzmann", None, None),
    "agents/dqn_bootstrap": ("DQN-Bootstrap", "bootstrap", "bootstrap", None, None),
    "agents/dqn_vime_map": ("DQN-VIME-MAP", "dqn", "epsilon_greedy", None, "map"),
    "agents/dqn_vime_mc": ("DQN-VIME-MC", "dqn", "epsilon_greedy", None, "mc"),
    "agents/bbqn_map": ("BBQN-MAP", "bbqn", "thompson", "map", None),
    "agents/bbqn_map_soft": ("Soft BBQN-MAP", "bbqn", "thompson_boltzmann", "map", None),
    "agents/bbqn_mc": ("BBQN-MC", "bbqn", "thompson", "mc", None),
    "agents/bbqn_vime_map": ("BBQN-VIME-MAP", "bbqn", "thompson", "map", "map"),
    "agents/bbqn_vime_mc": ("BBQN-VIME-MC", "bbqn", "thompson", "mc", "mc"),
    "agents/double_dqn": ("Double DQN", "dqn", "epsilon_greedy", None, None),
    "agents/noisy_dqn": ("Noisy DQN", "dqn", "noisy", None, None),
}


@pytest.mark.parametrize(
    "recipe", nightly(RECIPES, ["agents/bbqn_mc", "agents/dqn_bootstrap", "agents/noisy_dqn"])
)
def test_a_recipe_composes_the_agent_that_the_paper_gives_its_name(recipe):
    config = compose([f"+experiment={recipe}", "env=domain_ext"])
    agent, explore = config.agent.name, config.explore.name
    target, gain = getattr(config.agent, "target", None), getattr(config.intrinsic, "weights", None)
    assert (agent_name(asdict(config)), agent, explore, target, gain) == RECIPES[recipe]
    assert (config.env.name, config.protocol.rounds) == ("domain_ext", 200)


@pytest.mark.parametrize("agent", explorations())
def test_an_agent_brings_its_own_exploration_and_a_step_size_for_the_batches(agent):
    config = composed(f"agent={agent}")
    assert config.explore.name == explorations()[agent][0]
    assert (config.agent.lr, config.protocol.rounds) == (1e-3, 400)


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


def test_the_papers_start_is_the_prior_with_the_kl_at_full_weight():
    agent = compose(["+experiment=paper_start"]).agent
    assert (agent.mean_init, agent.std_init, agent.kl_temperature) == ("zero", None, 1.0)


def test_the_public_setting_has_no_errors_and_the_goals_of_the_first_template():
    config = compose(["+experiment=tcbot", "domain.path=corpus"])
    assert config.env.slot_error_prob == config.env.intent_error_prob == 0
    assert config.domain.goals == "user_goals_first_turn_template.part.movie.v1.p"
    assert config.protocol.rounds * config.protocol.dialogues == 2_000


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


def test_a_list_is_shared_out_among_the_replicas(tmp_path):
    command = ["replicas=4", "explore=thompson_epsilon", "agent.prior_std=[.05,.1,.2,.4]"]
    config = compose([*command, "explore.eps_init=[.2,.5]", "agent.lr=.01"])
    assert replica_values(config) == [
        {"agent.prior_std": 0.05, "explore.eps_init": 0.2},
        {"agent.prior_std": 0.1, "explore.eps_init": 0.2},
        {"agent.prior_std": 0.2, "explore.eps_init": 0.5},
        {"agent.prior_std": 0.4, "explore.eps_init": 0.5},
    ]
    save_config(config, tmp_path / "config.yaml")
    assert load_config(tmp_path / "config.yaml") == config
    assert replica_values(compose(["replicas=2"])) == [{}, {}]


@pytest.mark.parametrize(
    ("choices", "key"),
    [
        ("spike=imitate spike.dialogues=0", "spike.dialogues"),
        ("explore=epsilon_greedy explore.eps_init=[.1,.3] explore.eps_end=.2", "explore.eps_init"),
        ("agent=gp protocol.capacity=511", "agent.inducing"),
        ("protocol.capacity=31", "protocol.capacity"),
        ("device=cuda:x", "device"),
    ],
)
def test_what_does_not_fit_together_is_refused_by_key(choices, key):
    """The other rules have rows in tests/adversary/bad_input.yaml."""
    with pytest.raises(ConfigError, match=re.escape(f"{key} ")):
        compose(choices.split())


def test_the_edges_of_what_fits_together_are_composed():
    assert compose(["agent=gp", "protocol.capacity=512"]).protocol.capacity == 512
    assert compose(["protocol=quick", "agent=gp"]).protocol.capacity == 40_000
    compose(["protocol.capacity=32", "protocol.updates_per_round=2", "explore.temperature_end=.7"])
    compose(["agent=bootstrap", "agent.trunk_layers=2", "replicas=4", "agent.lr=[.1,.2]"])
