"""What a command line stands for, and what is refused before anything runs."""

from __future__ import annotations

import copy
import functools
import shutil
import sys
from dataclasses import fields, is_dataclass
from itertools import product

import pytest
import yaml
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from omegaconf import OmegaConf

from bbq_torchrl.cli import store
from bbq_torchrl.cli.command import command as main_function
from bbq_torchrl.cli.preparation import prepare
from bbq_torchrl.cli.resume import resumed_config
from bbq_torchrl.cli.saved import load_config, save_config
from bbq_torchrl.cli.store import compose, compose_raw, conf_folder, options, session, to_config
from bbq_torchrl.options import Config, ConfigError, EvaluateConfig, explorations, schemas
from bbq_torchrl.options.settings import walk
from bbq_torchrl.options.values import keys_with_lists, replica_values


@functools.cache
def composed(*choices):
    with session():
        return compose_raw(choices)


def checked(command):
    """The configuration of a command line as ``compose`` makes it, its options composed once.

    Only the reading of the keys is another: that is what takes long, and has tests of its own.
    """
    given = command.split()
    choices = [item for item in given if item.partition("=")[0] in schemas()]
    raw = copy.deepcopy(composed(*choices))
    raw.merge_with_dotlist([item for item in given if item not in choices])
    return to_config(raw, Config)


@pytest.mark.parametrize(("group", "option"), [(g, o) for g in schemas() for o in schemas()[g]])
def test_every_key_of_every_option_says_what_it_means_and_allows(group, option):
    for key, item, _ in walk(schemas()[group][option]()):
        if key != "name":
            assert item.metadata["meaning"], key
            assert item.metadata["allowed"].text, key


@pytest.mark.parametrize(("agent", "explore"), list(product(explorations(), options("explore"))))
def test_every_pair_is_composed_or_refused_by_name(agent, explore):
    raw = copy.deepcopy(composed(f"agent={agent}"))
    OmegaConf.set_struct(raw, False)
    raw.explore = OmegaConf.structured(schemas()["explore"][explore])
    if explore == "noisy" and agent == "dqn":
        raw.agent.noisy, raw.agent.dropout = True, 0
    if explore in explorations()[agent]:
        config = to_config(raw, Config)
        assert (config.agent.name, config.explore.name) == (agent, explore)
    else:
        with pytest.raises(ConfigError, match=f"agent={agent} .* explore={explore}.*must be one"):
            to_config(raw, Config)


TABLE_1 = {  # the paper's agents: network, exploration, target, intrinsic reward
    "dqn": ("dqn", "epsilon_greedy", None, None),
    "dqn_boltzmann": ("dqn", "boltzmann", None, None),
    "dqn_bootstrap": ("bootstrap", "bootstrap", None, None),
    "dqn_vime_map": ("dqn", "epsilon_greedy", None, "map"),
    "dqn_vime_mc": ("dqn", "epsilon_greedy", None, "mc"),
    "bbqn_map": ("bbqn", "thompson", "map", None),
    "bbqn_mc": ("bbqn", "thompson", "mc", None),
    "bbqn_vime_map": ("bbqn", "thompson", "map", "map"),
    "bbqn_vime_mc": ("bbqn", "thompson", "mc", "mc"),
}


@pytest.mark.parametrize("agent", TABLE_1)
def test_a_recipe_bears_the_papers_name_and_composes_its_agent(agent):
    config = compose([f"+experiment=agents/{agent}", "env=domain_ext"])
    vime = config.intrinsic.name == "vime"
    found = (
        config.agent.name,
        config.explore.name,
        getattr(config.agent, "target", None),
        config.intrinsic.weights if vime else None,
    )
    assert found == TABLE_1[agent]
    assert (config.env.name, config.protocol.rounds) == ("domain_ext", 200)


def test_a_recipe_is_what_table_1_has():
    agents = {name.removeprefix("agents/") for name in options("experiment") if "agents/" in name}
    assert agents == set(TABLE_1)


@pytest.mark.parametrize("agent", explorations())
def test_an_agent_brings_its_own_exploration(agent):
    assert composed(f"agent={agent}").explore.name == explorations()[agent][0]


def test_rounds_follow_the_environment_unless_given():
    assert checked("").protocol.rounds == 400
    assert checked("env=domain_ext").protocol.rounds == 200
    assert compose(["env=domain_ext", "protocol.rounds=20"]).protocol.rounds == 20


BEYOND_AGENTS = [n for n in options("experiment") if "/" not in n and n != "paper_start"]


@pytest.mark.parametrize("experiment", BEYOND_AGENTS)
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


@pytest.mark.parametrize("agent", explorations())
def test_the_learning_rate_goes_with_the_batch_size_unless_given(agent):
    assert checked(f"agent={agent}").agent.lr == 1e-3
    assert checked(f"agent={agent} protocol=quick").agent.lr == 2e-3
    assert checked(f"agent={agent} protocol=quick agent.lr=.1").agent.lr == 0.1


def own_conf(tmp_path, monkeypatch):
    """A copy of the configuration folder that takes its place."""
    conf = tmp_path / "conf"
    shutil.copytree(conf_folder(), conf)
    monkeypatch.setattr(store, "conf_folder", lambda: conf)
    return conf


def test_an_experiment_of_a_folder_decides_over_groups_and_keys(tmp_path, monkeypatch):
    conf = own_conf(tmp_path, monkeypatch)
    (conf / "experiment" / "agents" / "warm.yaml").write_text(
        "# @package _global_\n"
        "defaults: [override /agent: dqn, override /explore: boltzmann]\n"
        "agent:\n  lr: 0.5\n"
    )
    assert "agents/warm" in options("experiment")
    config = compose(["+experiment=agents/warm"])
    assert (config.agent.name, config.explore.name, config.agent.lr) == ("dqn", "boltzmann", 0.5)
    assert compose(["+experiment=agents/warm", "agent.lr=.1"]).agent.lr == 0.1


def test_the_folder_inside_an_installed_package_comes_first(tmp_path, monkeypatch):
    package = tmp_path / "bbq_torchrl"
    monkeypatch.setattr(store, "_PACKAGE", package)
    with pytest.raises(FileNotFoundError, match="no configuration folder 'conf'"):
        conf_folder()
    for folder in (tmp_path / "conf", package / "conf"):
        folder.mkdir(parents=True)
        (folder / "config.yaml").touch()
        assert conf_folder() == folder


REFUSED = {  # as it is read
    "agent=nope": "agent must be one of bbqn, bootstrap, dqn, got 'nope'",
    "explore=nope": "explore must be one of",
    "env=nope": "env must be one of domain_ext, full",
    "+experiment=nope": "experiment must be one of",
    "experiment=quick": "experiment is added with a plus: write +experiment=quick",
    "+agent=dqn": "+agent=dqn cannot be read: a group is chosen without a plus",
    "agent=bbqn,dqn": "dqn, got 'bbqn,dqn'; several options need --multirun",
    "seed=1,2": "seed=1,2 has several values: add --multirun",
    "seed=range(0,3)": "seed=range(0,3) has several values: add --multirun",
    "spike.name=none": "spike.name must be 'rule', got 'none': choose by spike=none",
    "~agent": "agent must be given",
    "~agent.lr": "~agent.lr cannot be read: no key can be removed",
    "agent.lr": "'agent.lr' cannot be read: write key=value",
    "+agent.nope=1": "agent.nope is not a key; the keys of agent=bbqn are name, hidden, lr",
    "+nope=1": "nope is not a key; the keys of the configuration are agent, explore, intrinsic",
    "agent.priorstd=1": "did you mean agent.prior_std",
    "nope=1": "nope is not a key",
    "seed=abc": "seed must be an integer from 0 to 2**63 - 1, got 'abc'",
    "agent.lr=abc": "lr must be a number from 1e-30 to 1e30 (or a list, one for",
    "agent.lr=0": "lr must be a number from 1e-30 to 1e30 (or a list, one for each replica), got 0",
    "agent={lr:1}": "agent must be one of bbqn, bootstrap, dqn, got '{lr:1}'",
    "agent.lr=${nope}": "agent.lr=${nope} cannot be resolved: Interpolation key 'nope' not found",
    "agent.hidden=[8,${nope}]": "agent.hidden[1]=${nope} cannot be resolved",
    "agent.lr=${agent.lr}": "agent.lr=${agent.lr} cannot be resolved: Recursive interpolation",
    "agent.hidden={a:1}": "agent.hidden must be a list of up to 100 integers from 1 to 10**9",
    "+seed=1": "'+seed' cannot be read: a key that there is already goes without a plus",
    "=1": "'=1' cannot be read",
    "agent.gamma=1.5": "agent.gamma must be a number between 0 and 1 (or a list, one for each",
    "replicas=1.5": "replicas must be an integer",
    "domain=miulab": "domain.path must be given",
    "domain=movie domain.path=x": "domain.path is not a key; the keys of domain=movie are name",
    "spike=none spike.dialogues=5": "spike.dialogues must be 0, or be given with spike=rule, got 5",
    "env=domain_ext agent.kl=sampled": "agent.kl must be closed",
    "agent=dqn agent.prior_std=.1": "agent.prior_std is not a key",
    "agent.lr=.1,.2": "add --multirun to run them all, or put them in brackets for the replicas",
    "replicas=2 agent.target=[map,mc]": "agent.target must be one of map, mc, got '[map,mc]'",
    "replicas=2 seed=[0,1]": "seed must be an integer from 0 to 2**63 - 1, got '[0,1]'",
    "intrinsic=nope": "intrinsic must be one of none, vime, got 'nope'",
    "intrinsic.eta=1": "intrinsic.eta is not a key; the keys of intrinsic=none are name",
    "agent.lr=nan": "(or a list, one for each replica), got nan",
    "agent.hidden=256": "agent.hidden must be a list of up to 100 integers from 1 to 10**9",
    "spike.protect=maybe": "spike.protect must be true or false",
    "agent=dqn replicas=2 agent.dropout=[.1,.2]": "agent.dropout must be a number from 0 to below",
}
REFUSED_VALUES = {  # as it is checked
    "agent.name=dqn": "agent.name must be 'bbqn', got 'dqn': choose by agent=dqn",
    "seed=-1": "seed must be an integer from 0 to 2**63 - 1, got -1",
    "seed=18446744073709551616": "2**63 - 1, got 18446744073709551616",
    "threads=100000": "threads must be an integer from 1 to 1024, got 100000",
    "env.success_reward=1e39": "env.success_reward must be a number from -1e15 to 1e15, got 1e+39",
    "agent.noise_std=1e-200": "agent.noise_std must be a number from 1e-15 to 1e15",
    "intrinsic=vime intrinsic.eta=1e300": "intrinsic.eta must be a number from 0 to 1e15",
    "agent=dqn explore=boltzmann explore.temperature_end=1e-300": "explore.temperature_end must",
    "agent.hidden=[10000000000]": "integers from 1 to 10**9, such as [256,256], got [10000000000]",
    "protocol.dialogues=10000000000": "protocol.dialogues must be an integer from 1 to 10**9",
    "protocol={rounds:3}": "protocol must be one of paper, quick, got '{rounds:3}'",
    "agent.hidden=[]": "agent.hidden must be a list of up to 100 integers",
    "agent.prior_std=-1": "(or a list, one for each replica) or 'fan_in', got -1",
    "agent.prior_std=wide": "(or a list, one for each replica) or 'fan_in', got 'wide'",
    "agent.target=both": "agent.target must be one of map, mc, got 'both'",
    "replicas=0": "replicas must be an integer from 1 to 10**9, got 0",
    "device=tpu": "device must be 'cpu', 'cuda' or 'cuda:<number>', got 'tpu'",
    "protocol.rounds=0": "protocol.rounds must be an integer from 1 to 10**9, got 0",
    "protocol.capacity=8": "protocol.capacity must be at least protocol.batch_size",
    "protocol.eval_every=-1": "protocol.eval_every must be an integer from 0 to 10**9, got -1",
    "protocol.eval_every_dialogues=0": "protocol.eval_every_dialogues must be an integer from 1",
    "agent.evaluate=median": "agent.evaluate must be one of mean, average, draw, thompson, got",
    "spike.dialogues=-1": "spike.dialogues must be an integer from 0 to 10**9, got -1",
    "env.slot_error_prob=2": "env.slot_error_prob must be a number between 0 and 1",
    "env.slot_error_mode=foo": "env.slot_error_mode must be one of value, slot, delete, mixed",
    "env.max_turn=1": "env.max_turn must be an integer from 2 to 10**9, got 1",
    "domain=folder domain.path=''": "domain.path must be a text, got ''",
    "spike.drop_above=.5 spike.protect=false": "spike.drop_above cannot be combined",
    "agent=dqn agent.noisy=true agent.dropout=.5": "agent.dropout must be 0",
    "agent=dqn explore=noisy": "agent.noisy must be true",
    "agent.target_noise=shared": "agent.target_noise must be mean with agent.target=map, got",
    "agent.target=mc agent.target_noise=mean": "agent.target_noise must be independent or shared",
    "agent.target_noise=none": "agent.target_noise must be one of mean, independent, shared",
    "agent=bootstrap agent.heads=0": "agent.heads must be an integer from 1 to 10**9, got 0",
    "agent=bootstrap agent.mask_prob=0": "agent.mask_prob must be a number above 0 and up to 1",
    "agent=bootstrap agent.trunk_layers=3": "agent.trunk_layers must be at most the 2 layers",
    "agent.prior_std=[.1,.2]": "agent.prior_std must be one value or a list of 1 (one for each of",
    "replicas=4 agent.lr=[.1,.2,.3]": "or of a number that divides 4, got 3: [0.1, 0.2, 0.3]",
    "replicas=2 agent.lr=[.1,-1]": "lr must be a number from 1e-30 to 1e30 (or a list, one for",
    "agent.lr=[]": "1e-30 to 1e30 (or a list, one for each replica), got []",
    "replicas=2 agent.prior_std=[.1,fan_in]": "agent.prior_std must be a number from 1e-15 to 1e15",
    "agent=dqn explore.anneal_fraction=1.5": "explore.anneal_fraction must be a number between",
    "agent=dqn explore.anneal_fraction=-.1": "explore.anneal_fraction must be a number between",
    "agent=dqn explore.eps_init=.005": "explore.eps_init must be at least explore.eps_end (0.01)",
    "agent=dqn replicas=2 explore.eps_end=[.1,.2]": "explore.eps_init must be at least explore.eps",
    "intrinsic=vime intrinsic.eta=-1": "intrinsic.eta must be a number from 0 to 1e15 (or a list",
    "intrinsic=vime intrinsic.weights=all": "intrinsic.weights must be one of map, mc, got 'all'",
}


LONG = {
    "deep": "agent.hidden=" + "[" * 3000 + "]" * 3000,
    "a number of 400 digits": f"env.success_reward={'9' * 400}",
    "a number of 5000 digits": f"seed={'9' * 5000}",
    "a value": f"agent.mean_init={'x' * 100_000}",
    "a key": f"{'x' * 100_000}=1",
    "no key": "x" * 100_000,
}


@pytest.mark.parametrize("override", LONG.values(), ids=LONG)
def test_what_is_very_long_or_deep_is_refused_in_a_line_that_is_not(override):
    with pytest.raises(ConfigError) as refused:
        compose([override])
    message = str(refused.value)
    assert override[:10] in message
    assert len(message) < 600
    assert "\n" not in message


@pytest.mark.parametrize("command", REFUSED)
def test_what_cannot_be_run_is_refused_in_one_sentence(command):
    with pytest.raises(ConfigError) as refused:
        compose(command.split())
    message = str(refused.value)
    assert REFUSED[command] in message
    assert "\n" not in message.strip()


@pytest.mark.parametrize("command", REFUSED_VALUES)
def test_a_value_that_cannot_be_run_is_refused_in_one_sentence(command):
    with pytest.raises(ConfigError) as refused:
        checked(command)
    message = str(refused.value)
    assert REFUSED_VALUES[command] in message
    assert "\n" not in message.strip()


REFUSED_EVALUATIONS = {
    "dialogues=5": "policy must be given, as policy=<value>",
    "policy=rule seed=1,2": "seed=1,2 has several values: each key has one value in this command",
    "policy=rule env=full,domain_ext": "got 'full,domain_ext'; each key has one value in this",
    "policy=rule dialogues=0": "dialogues must be an integer from 1 to 10**9, got 0",
    "policy=rule weights=first": "weights must be one of last, best, got 'first'",
    "policy=rule agent=dqn": "agent is not a key; the keys of the configuration are env, domain",
    "policy=rule env.priorstd=1": "env.priorstd is not a key; the keys of env=full are name",
    "policy=rule +experiment=quick": "experiment is for training only",
}


@pytest.mark.parametrize("command", REFUSED_EVALUATIONS)
def test_an_evaluation_that_cannot_run_is_refused_in_one_sentence(command):
    with pytest.raises(ConfigError) as refused:
        compose(command.split(), EvaluateConfig)
    assert REFUSED_EVALUATIONS[command] in str(refused.value)
    assert "\n" not in str(refused.value)


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


def test_lists_are_for_these_keys():
    assert list(keys_with_lists(schemas())) == [
        "agent.lr",
        "agent.gamma",
        "agent.prior_std",
        "agent.std_init",
        "agent.noise_std",
        "agent.kl_temperature",
        "explore.eps_init",
        "explore.eps_end",
        "explore.temperature_init",
        "explore.temperature_end",
        "intrinsic.eta",
    ]


def test_a_sweep_may_be_over_lists(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    checked = []
    prepare(["--multirun", "replicas=2", "agent.lr=[.1,.2],[.3,.4]"], checked.append)
    assert [config.agent.lr for config in checked] == [[0.1, 0.2], [0.3, 0.4]]


def test_every_job_of_a_sweep_is_checked_before_the_first_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match="agent=dqn cannot be combined"):
        prepare(["--multirun", "agent=bbqn,dqn", "explore=thompson"], lambda config: None)
    assert not list(tmp_path.iterdir())


def test_the_jobs_of_a_sweep_that_an_experiment_asks_for_are_checked(tmp_path, monkeypatch):
    conf = own_conf(tmp_path, monkeypatch)
    (conf / "experiment" / "sweep.yaml").write_text(
        "# @package _global_\n"
        "hydra:\n  mode: MULTIRUN\n  sweeper:\n    params:\n      agent.lr: .1,.2,-1\n"
    )
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        ConfigError, match=r"agent\.lr must be a number from 1e-30 to 1e30 .*, got -1"
    ):
        prepare(["+experiment=sweep"], lambda config: None)
    checked = []
    prepare(["+experiment=sweep", "agent.lr=.3,.4"], checked.append)
    assert [config.agent.lr for config in checked] == [0.3, 0.4]


def test_jobs_that_only_another_sweeper_knows_are_left_to_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other = ["--multirun", "hydra.sweeper._target_=some.OtherSweeper", "agent.lr=interval(.1,.2)"]
    assert prepare(other, fail)[:-1] == other
    with pytest.raises(ConfigError, match="BasicSweeper does not support"):
        prepare(["--multirun", "agent.lr=interval(.1,.2)"], fail)


def test_a_single_run_is_what_was_composed_and_checked_once(tmp_path, monkeypatch):
    composed, checked, ran = [], [], []
    compose_once = ConfigLoaderImpl.load_configuration

    def counted(self, *args, **kwargs):
        composed.append(compose_once(self, *args, **kwargs))
        return composed[-1]

    def check(config):
        checked.append((config, object()))  # the second stands for the domain
        return checked[-1][1]

    def task(config, folder, domain):
        ran.append((config, domain))
        assert folder == tmp_path / "it"
        return 0.0

    monkeypatch.setattr(ConfigLoaderImpl, "load_configuration", counted)
    monkeypatch.setattr(sys, "argv", ["train.py", "agent=dqn", f"hydra.run.dir={tmp_path / 'it'}"])
    main_function(check, tuple)(task)()
    assert len(composed) == len(checked) == len(ran) == 1
    assert all(one is other for one, other in zip(ran[0], checked[0], strict=True))
    assert "agent=dqn" in (tmp_path / "it" / ".hydra" / "overrides.yaml").read_text()


@pytest.mark.parametrize("command", [["agent=dqn"], ["--multirun", "agent=bbqn,dqn"]])
def test_two_runs_of_one_second_get_folders_of_their_own(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    prepared = [prepare(command, lambda config: None)[-1] for _ in range(3)]
    assert len(set(prepared)) == 3


@pytest.mark.parametrize(
    "command", [["--help"], ["--cfg", "job", "agent=dqn"], ["--info"], ["--hydra-help"]]
)
def test_what_only_shows_something_is_left_to_hydra(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    assert prepare(command, fail) == command
    assert not list(tmp_path.iterdir())


def fail(config):
    raise ValueError("nothing was to be checked")


def test_a_run_that_fails_its_check_leaves_no_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="nothing was to be checked"):
        prepare(["agent=dqn"], fail)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["--config-name", "other"], "--config-name is not supported: choose by <group>=<option>"),
        (["--config-path", "."], "--config-path is not supported"),
        (["--multirun", "seed=1,2", "resume=somewhere"], "cannot be combined with --multirun"),
        (["--multirun", "seed=range(0"], "cannot be read: write key=value"),
    ],
)
def test_what_hydra_would_misread_is_refused(command, message):
    with pytest.raises(ConfigError, match=message):
        prepare(command, lambda config: None)


def test_a_resumed_run_goes_on_in_its_folder_with_hydras_record_as_it_was(tmp_path):
    folder = tmp_path / "it's a run"
    folder.mkdir()
    save_config(compose(["agent=dqn"]), folder / "config.yaml")
    checked = []
    # Quoted as the shell hands it over to Hydra's grammar.
    quoted = str(folder).replace("'", "\\'")
    prepared = prepare([f"resume='{quoted}'"], checked.append)
    assert checked[0].agent.name == "dqn"
    assert prepared[1:] == [f"hydra.run.dir='{quoted}'", "hydra.output_subdir=null"]


def test_a_run_folder_is_not_used_twice(tmp_path):
    save_config(compose(), tmp_path / "config.yaml")
    with pytest.raises(ConfigError, match="already holds a run"):
        prepare([f"hydra.run.dir={tmp_path}"], lambda config: None)


@pytest.mark.parametrize(
    "command",
    [
        [],
        ["agent=dqn", "env=domain_ext", "seed=3"],
        ["protocol=quick", "spike=none"],
        ["agent=bootstrap", "intrinsic=vime"],
    ],
)
def test_a_saved_configuration_is_read_back_as_it_was(tmp_path, command):
    config = compose(command)
    save_config(config, tmp_path / "config.yaml")
    assert load_config(tmp_path / "config.yaml") == config


COSTLY = ["protocol.rounds=30", "protocol.dialogues=50", "protocol.batch_size=32"]
COSTLY += ["protocol.capacity=640", "protocol.freezes=1", "protocol.epochs=2", "env.max_turn=38"]


@pytest.mark.parametrize(
    ("choices", "evaluation", "training"),
    [
        # 20 steps of 200 + dialogues; a round: 20 steps of 200 + 50, 40 updates of 200 + 32.
        ([], (20, 3_000, 64_000), (20, 50, 40, 32, 14_280)),
        # Three replicas of 3,000, 800 at a time: four times 20 steps.
        (["replicas=3"], (80, 2_400, 208_000), (20, 150, 40, 96, 18_840)),
    ],
)
def test_evaluations_that_take_longer_than_training_are_refused_with_the_numbers(
    choices, evaluation, training
):
    steps, places, cost = evaluation
    turns, dialogues, updates, rows, a_round = training
    choices = [*COSTLY, *choices, "protocol.eval_batch=3000", "protocol.eval_every_dialogues=3000"]
    if "replicas=3" in choices:
        choices.append("protocol.eval_batch=2400")
    enough = -(-cost // a_round)
    compose([*choices, f"protocol.eval_every={enough}"])
    with pytest.raises(ConfigError) as refused:
        compose([*choices, f"protocol.eval_every={enough - 1}"])
    message, every = str(refused.value), enough - 1
    assert f"protocol.eval_every must be 0 or at least {enough} with" in message
    assert f"protocol.eval_every_dialogues=3000, got {every}" in message
    assert f"an evaluation of {steps} steps with {places:,} dialogues side by side" in message
    assert f"of {every * turns} steps with {dialogues} and {every * updates} updates" in message
    assert f"of {rows} transitions ({cost:,} against {every * a_round:,}," in message


@pytest.mark.parametrize(
    "choices",
    [
        ["protocol.eval_every=0"],  # never
        ["protocol.eval_every=31"],  # not in this training
    ],
)
def test_an_evaluation_that_never_is_costs_nothing(choices):
    compose([*COSTLY, *choices, "protocol.eval_every_dialogues=100000"])


def test_a_run_of_a_version_without_evaluation_while_training_has_none(tmp_path):
    file = tmp_path / "config.yaml"
    save_config(compose(["agent=dqn"]), file)
    saved = yaml.safe_load(file.read_text())
    del saved["protocol"]["eval_every"], saved["protocol"]["eval_every_dialogues"]
    file.write_text(yaml.safe_dump(saved))
    assert load_config(file).protocol.eval_every == 0


def test_a_run_of_a_version_without_intrinsic_rewards_has_none(tmp_path):
    file = tmp_path / "config.yaml"
    save_config(compose(["agent=dqn"]), file)
    saved = yaml.safe_load(file.read_text())
    del saved["intrinsic"]
    file.write_text(yaml.safe_dump(saved))
    assert load_config(file).intrinsic.name == "none"


class TestResume:
    @pytest.fixture
    def folder(self, tmp_path):
        save_config(compose(["agent=dqn", "protocol.rounds=5"]), tmp_path / "config.yaml")
        return tmp_path

    def resume(self, folder, *overrides):
        command = [f"resume={folder}", *overrides]
        return resumed_config(compose(command), command)

    def test_takes_the_configuration_of_the_folder(self, folder):
        config = self.resume(folder)
        assert (config.agent.name, config.explore.name) == ("dqn", "epsilon_greedy")
        assert config.protocol.rounds == 5

    def test_may_train_longer_and_log_elsewhere(self, folder):
        config = self.resume(folder, "protocol.rounds=9", "logger=tensorboard")
        assert config.protocol.rounds == 9
        assert config.logger.name == "tensorboard"

    def test_may_repeat_what_the_run_has_anyway(self, folder):
        assert self.resume(folder, "agent=dqn", "seed=0").agent.name == "dqn"

    @pytest.mark.parametrize(
        "override",
        [
            "agent=bbqn",
            "seed=1",
            "protocol.batch_size=8",
            "+experiment=quick",
            "hydra.run.dir=elsewhere",
        ],
    )
    def test_refuses_what_contradicts_the_run(self, folder, override):
        with pytest.raises(ConfigError, match="contradicts the run"):
            self.resume(folder, override)

    def test_refuses_fewer_rounds(self, folder):
        with pytest.raises(ConfigError, match=r"protocol\.rounds must be at least 5"):
            self.resume(folder, "protocol.rounds=4")

    def test_says_that_a_run_is_finished(self, folder):
        (folder / "result.json").write_text('{"rounds": 5}')
        (folder / "curve.png").touch()
        with pytest.raises(ConfigError, match="is finished"):
            self.resume(folder)

    def test_extends_a_finished_run(self, folder):
        (folder / "result.json").write_text('{"rounds": 5}')
        (folder / "curve.png").touch()
        assert self.resume(folder, "protocol.rounds=6").protocol.rounds == 6

    def test_refuses_a_folder_that_is_no_run_folder(self, tmp_path):
        with pytest.raises(ConfigError, match=r"is not a run folder: it has no config\.yaml"):
            self.resume(tmp_path)
        with pytest.raises(ConfigError, match="is not a run folder: there is no such folder"):
            self.resume(tmp_path / "nowhere")

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("agent: [", "is not a YAML file of a run"),
            ("- 1", "must hold a mapping of groups, got a list"),
            ("seed: 1", "agent must be given"),
            ("agent:\n  name: nope", "agent must be one of bbqn, bootstrap, dqn, got 'nope'"),
        ],
    )
    def test_refuses_a_folder_whose_configuration_is_damaged(self, folder, text, message):
        (folder / "config.yaml").write_text(text)
        with pytest.raises(ConfigError, match=message):
            self.resume(folder)


def test_evaluation_composes_from_the_same_groups():
    config = compose(["policy=rule", "env=domain_ext"], EvaluateConfig)
    assert is_dataclass(config.env)
    assert config.env.name == "domain_ext"
    shared = {item.name for item in fields(Config)} & {item.name for item in fields(EvaluateConfig)}
    assert {"env", "domain", "seed", "device"} <= shared
