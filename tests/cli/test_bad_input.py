"""What cannot be run is refused before anything runs, in one line, and leaves nothing behind."""

from __future__ import annotations

import json
import pickle
import shutil
import sys
from datetime import date

import pytest
import torch
from prepared import prepare

from bbq_torchrl import evaluate
from bbq_torchrl.cli.agent import make_agent
from bbq_torchrl.cli.checks import check
from bbq_torchrl.cli.loading import trained_policy
from bbq_torchrl.cli.resume import save_config
from bbq_torchrl.cli.store import compose
from bbq_torchrl.extras import install_command


@pytest.fixture
def refused(refused, tmp_path):
    """The same; such a command line leaves nothing behind."""

    def run(*arguments):
        line = refused(*arguments)
        assert not list((tmp_path / "here").iterdir())
        return line

    return run


def test_a_damaged_domain_folder(refused, restaurant_folder, tmp_path):
    """Every fault of every file is in tests/domains; here one, as the command tells it."""
    folder = tmp_path / "domain"
    shutil.copytree(restaurant_folder, folder)
    file = folder / "knowledge_base.csv"
    file.write_text(file.read_text().replace("terrace", "balcony", 1))
    assert "balcony" in refused("domain=folder", f"domain.path={folder}")


def test_a_pickle_with_a_class_in_it(refused, tmp_path):
    for name in ("user_goals_first_turn_template.v2.p", "movie_kb.1k.p", "dicts.v3.p"):
        (tmp_path / name).write_bytes(pickle.dumps({"day": date(2018, 2, 2)}, protocol=2))
    message = refused("domain=miulab", f"domain.path={tmp_path}")
    assert "datetime" in message


def test_a_device_that_is_absent(refused):
    number = torch.cuda.device_count()
    assert f"device=cuda:{number} is absent" in refused(f"device=cuda:{number}")


def test_a_logger_whose_package_is_missing(refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "mlflow", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name, package=None: None)
    message = refused("logger=mlflow")
    assert f"logger=mlflow needs the package mlflow: {install_command('mlflow')}" in message


def test_a_scripted_policy_that_the_domain_lacks(refused, restaurant_folder):
    message = refused("domain=folder", f"domain.path={restaurant_folder}", "spike.policy=greedy")
    assert "spike.policy must be one of rule, careful, got 'greedy'" in message


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("agent.priorstd=1", "did you mean agent.prior_std?"),
        ("resume=nowhere", "nowhere is not a run folder: there is no such folder"),
        ("--multirun agent=bbqn,dqn explore=thompson", "agent=dqn cannot be combined"),
    ],
)
def test_a_wrong_command_line(refused, override, message):
    assert message in refused(*override.split())


def test_a_buffer_that_the_spike_would_fill(refused):
    line = refused("spike.dialogues=100", "protocol.capacity=800")  # a rule dialogue has 8 turns
    assert "protocol.capacity must be more than the transitions of spike.dialogues=100" in line
    line = refused("--multirun", "seed=1,2", "spike.dialogues=1000", "protocol.capacity=900,20000")
    assert "which are 1000, got 900" in line


def test_a_buffer_with_room_for_one_more_than_the_spike():
    check(compose(["spike.dialogues=100", "protocol.capacity=801"]))


def test_a_slot_with_actions_that_domain_extension_would_never_activate(
    refused, restaurant_folder, tmp_path
):
    folder = tmp_path / "domain"
    shutil.copytree(restaurant_folder, folder)
    file = folder / "domain.yaml"
    file.write_text(file.read_text().replace("extension_order: [restaurant,", "extension_order: ["))
    where = ("domain=folder", f"domain.path={folder}")
    line = refused(*where, "env=domain_ext")
    assert "domain extension would never activate restaurant" in line
    check(compose([*where, "env=full"]))


def evaluation_refused(capsys, *arguments):
    assert evaluate.main(arguments) == 2
    out, err = capsys.readouterr()
    assert not out
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("policy=nope", "policy must be a run folder or one of rule, rule_inform"),
        ("policy=rule mode=mean", "mode must be null for policy=rule, got 'mean'"),
        ("policy=rule device=cuda:99", "device=cuda:99 is absent"),
        ("policy=rule domain=folder domain.path=nowhere", "nowhere"),
        ("polcy=rule", "did you mean policy?"),
        ("policy=rule --multirun", "'--multirun' cannot be read: write key=value"),
    ],
)
def test_a_wrong_evaluation(capsys, arguments, message):
    assert message in evaluation_refused(capsys, *arguments.split())


def test_a_run_folder_that_is_none_or_has_no_checkpoint(capsys, tmp_path):
    assert "is not a run folder" in evaluation_refused(capsys, f"policy={tmp_path}")
    save_config(compose(["agent=dqn"]), tmp_path / "config.yaml")
    message = evaluation_refused(capsys, f"policy={tmp_path}")
    assert "has no checkpoint yet" in message


@pytest.mark.parametrize(
    ("fraction", "epsilons"),
    [(0, [0.5, 0.1, 0.1, 0.1]), (0.5, [0.5, 0.3, 0.1, 0.1]), (1, [0.5, 0.4, 0.3, 0.2])],
)
def test_a_schedule_falls_over_its_share_of_the_rounds(fraction, epsilons):
    given = ["explore.eps_init=.5", "explore.eps_end=.1", f"explore.anneal_fraction={fraction}"]
    config = compose(["agent=dqn", "protocol.rounds=4", *given])
    env = config.env.make(config.domain.make(), (1, 2))
    agent = make_agent(config, env)
    seen = []
    for _ in range(4):
        seen.append(float(agent.metrics["epsilon"]()))
        for module in agent.policy.modules():
            if hasattr(module, "step"):
                module.step(1)
    assert seen == pytest.approx(epsilons)


@pytest.mark.parametrize(
    ("agent", "mode", "allowed"),
    [
        ("dqn", "mean", "null for agent=dqn"),
        ("bbqn", "nope", "one of mean, average, draw, thompson or null for agent=bbqn"),
    ],
)
def test_a_mode_must_be_one_of_the_agents(agent, mode, allowed, tmp_path):
    config = compose([f"agent={agent}"])
    env = config.env.make(config.domain.make(), (1, 2))
    with pytest.raises(ValueError, match=f"mode must be {allowed}, got '{mode}'"):
        trained_policy(config, tmp_path, env, mode=mode)


def test_the_public_corpus_is_evaluated_with_files_and_difficulty_of_choice(capsys, tcbot):
    arguments = [
        "policy=careful",
        "dialogues=40",
        "batch=16",
        "domain=miulab",
        f"domain.path={tcbot}",
        "domain.goals=user_goals_first_turn_template.part.movie.v1.p",
        "domain.kb=movie_kb.1k.p",
        "env.slot_error_prob=.05",
        "env.slot_error_mode=value",
        "env.intent_error_prob=0",
        "env.max_turn=40",
    ]
    assert evaluate.main(arguments) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["domain"], answer["dialogues"]) == ("miulab", 40)
    # The scripted policy succeeds in about two thirds of the dialogues at this difficulty.
    assert answer["success_rate"] > 0.2


def test_a_sweep_whose_glob_names_nothing(refused):
    line = refused("--multirun", "+experiment=glob(agents/*)", "protocol=quick")
    assert "sweep without a job" in line
    assert "+experiment/agents=glob(*)" in line


def test_a_sweep_gets_the_folder_that_it_was_given_or_is_refused(refused, tmp_path):
    folder = tmp_path / "new" / "sweep"
    arguments = ["--multirun", "seed=1,2", f"hydra.sweep.dir={folder}"]
    assert prepare(arguments)[-1] == f"hydra.sweep.dir='{folder}'"
    assert folder.is_dir()
    line = refused(*arguments)
    assert f"or that of a sweep to go on with, got {folder}" in line
    (folder / "multirun.yaml").touch()
    assert prepare(arguments)[-1] == f"hydra.sweep.dir='{folder}'"
    job = folder / "1_bbqn_thompson_full_seed2"
    job.mkdir()
    save_config(compose(["seed=2"]), job / "config.yaml")
    assert prepare(arguments)[-1] == f"hydra.sweep.dir='{folder}'"
    line = refused(*arguments, "agent.lr=.5")
    assert f"{job} already holds another run" in line
