"""Options of another package: they train, resume, evaluate, report and search like ours."""

import dataclasses
import shutil

import forked
import pytest
from adversary.folders import state
from extended import PACKAGE, SHRUNKEN
from tiny import composed, nightly, rows
from torchrl.data import Composite, Unbounded

from bbq_torchrl.cli import evaluate
from bbq_torchrl.evaluation import compare_runs
from bbq_torchrl.evaluation.curves import read_metrics
from bbq_torchrl.options import explorations, registry
from bbq_torchrl.runs.build import check_resources
from bbq_torchrl.runs.compose import compose, usage
from bbq_torchrl.runs.train import build_trainer, run
from bbq_torchrl.search.definition import compose_search
from bbq_torchrl.settings import ConfigError

RUNS = {
    "agent and environment": ("agent=langevin", "agent.inverse_temperature=[1e4,1e8]"),
    "strategy and intrinsic reward": ("agent=bbqn", "explore=ucb", "intrinsic=visits"),
    "agent and strategy": ("agent=epinet", "agent.index_size=3"),
}


pytestmark = pytest.mark.usefixtures("installed", "without_curves")


@pytest.fixture(scope="module")
def finished(installed, tmp_path_factory):
    """A finished run of each of the command lines."""
    folders = {}
    for name, choices in RUNS.items():
        folders[name] = tmp_path_factory.mktemp("run")
        run(composed(*choices, *SHRUNKEN), folders[name])
    return folders


def test_its_options_are_paired_by_what_they_need():
    known = explorations()
    assert known["langevin"][0] == "greedy"
    assert known["epinet"] == ("index", "epsilon_greedy", "greedy")
    assert [agent for agent, names in known.items() if "ucb" in names] == ["bbqn", "gp"]
    assert "chain" in registry.options("env")
    assert "\n  langevin " in usage()
    assert "visits" in registry.options("intrinsic")


def test_its_keys_are_checked_and_it_is_not_spiked_without_scripted_policies():
    with pytest.raises(ConfigError, match=r"explore\.draws must be an integer from 2 to .*, got 1"):
        compose(["explore=ucb", "explore.draws=1"])
    with pytest.raises(ConfigError, match="spike must be none with env=chain"):
        check_resources(compose(["env=chain", "protocol=quick"]))


@pytest.mark.parametrize(
    ("batch_size", "features"), [((2, 4), (4, 5)), ((2, 4), ()), ((), (5,)), ((4,), (5,))]
)
def test_the_environment_of_an_option_is_checked(batch_size, features, monkeypatch, tmp_path):
    from bbq_extending.chain_env import ChainEnv

    env = ChainEnv(5, batch_size)
    specs = {**env.observation_spec, "observation": Unbounded((*batch_size, *features))}
    env.observation_spec = Composite(specs, shape=batch_size)
    config = composed("agent=bbqn", "explore=thompson", *SHRUNKEN)
    monkeypatch.setattr(type(config.env), "make", lambda *_, **__: env)
    with pytest.raises(ConfigError, match="env=chain"):
        build_trainer(config, tmp_path)


@pytest.mark.parametrize("name", nightly(RUNS, ["strategy and intrinsic reward"]))
def test_a_resumed_run_ends_bitwise_as_one_that_was_not_interrupted(name, finished, tmp_path):
    config = composed(*RUNS[name], *SHRUNKEN)
    one_round = dataclasses.replace(config.protocol, rounds=1)
    run(dataclasses.replace(config, protocol=one_round), tmp_path)
    run(dataclasses.replace(config, resume=str(tmp_path)), tmp_path)

    assert state(tmp_path) == state(finished[name])
    assert rows(tmp_path / "metrics.csv") == rows(finished[name] / "metrics.csv")


def test_its_runs_are_evaluated_and_reported(finished, capsys):
    folders = [str(folder) for folder in finished.values()]
    for policy in (*folders, "random"):
        given = [f"policy={policy}", "env=chain", "env.length=5", "dialogues=6", "batch=3"]
        line = evaluate.evaluation(evaluate.composed(given))
        assert line["turns"] == 14
        assert "domain" not in line
    assert "states_seen" in read_metrics(finished["strategy and intrinsic reward"]).columns
    capsys.readouterr()
    assert compare_runs.main(folders) == 0
    out = capsys.readouterr().out
    assert "LANGEVIN, explore=greedy, agent.inverse_temperature=100000000.0" in out
    assert "BBQN-MAP" in out


def test_its_search_space_is_found_in_a_folder_of_options(monkeypatch):
    monkeypatch.setenv(registry.FOLDER_VARIABLE, str(PACKAGE))
    search = compose_search(["search=langevin", *SHRUNKEN])
    assert list(search.space) == ["agent.lr", "agent.inverse_temperature"]
    config = search.config({"agent.lr": 0.01, "agent.inverse_temperature": 1e5})
    assert (config.agent.name, config.agent.lr) == ("langevin", 0.01)


@pytest.mark.slow
def test_the_installed_package_is_found_by_a_sweep_and_its_processes(tmp_path, monkeypatch):
    copy, site, runs = (tmp_path / name for name in ("copy", "site", "runs"))
    shutil.copytree(PACKAGE, copy)
    # What builds the package is installed already or comes from the index.
    pip = ("-m", "pip", "install", "-q", "--no-deps", "--target", site, copy)
    forked.python(*pip, cwd=tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(site))
    # With two jobs at a time, even a single one runs in a process of its own.
    sweep = ("--multirun", "hydra.launcher.n_jobs=2", f"hydra.sweep.dir={runs}")
    chosen = ("agent=bbqn", "explore=ucb", "intrinsic=visits")
    forked.python(forked.ROOT / "train.py", *sweep, *chosen, *SHRUNKEN, cwd=tmp_path)
    assert len(list(runs.glob("*/result.json"))) == 1
