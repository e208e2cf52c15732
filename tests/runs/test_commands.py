"""The commands as a person types them, on a protocol that is shrunk to seconds.

Training runs in children of this process; processes of their own are in the slow tests of
``test_launchers.py``, ``test_values.py`` and ``tests/adversary``.
"""

import json
import shutil

import forked
import pytest
import torch
from tiny import TINY, composed

from bbq_torchrl import load_run
from bbq_torchrl.cli import evaluate
from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.runs.build import checkout, divergence
from bbq_torchrl.runs.compose import usage
from bbq_torchrl.runs.folders import load_config
from bbq_torchrl.runs.train import main as train_main, run
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import evaluate as evaluate_policy

TRAIN = forked.ROOT / "train.py"

pytestmark = pytest.mark.usefixtures("without_curves")


def train(command, *more, cwd, code=0):
    return forked.call(train_main, *command.split(), *more, cwd=cwd, code=code)


def test_the_result_says_what_ran_and_how_well(commanded):
    result = json.loads((commanded / "result.json").read_text())
    expected = {"agent": "bbqn", "explore": "thompson", "env": "domain_ext", "domain": "hotel"}
    expected |= {"seed": 7, "rounds": 3, "replicas": 3, "dialogues": 90}
    assert {key: result[key] for key in expected} == expected
    assert [item["dialogues"] for item in result["per_replica"]] == [30, 30, 30]
    assert result["commit"] == checkout().commit
    assert {"torch", "torchrl", "tensordict", "bbq-torchrl"} <= result["versions"].keys()
    begun, ended = (
        (commanded / file).stat().st_mtime for file in (".hydra/overrides.yaml", "result.json")
    )
    assert 0 < result["wall_seconds"] < ended - begun + 1


@pytest.mark.parametrize("mode", ["mean", "average", "thompson"])
def test_a_trained_run_is_evaluated_by_every_policy_of_its_posterior(commanded, capsys, mode):
    assert evaluate.main([f"policy={commanded}", "dialogues=25", "batch=10", f"mode={mode}"]) == 0
    printed = capsys.readouterr()
    (line,) = printed.out.splitlines()
    answer = json.loads(line)
    assert f"result.json has {read_result(commanded).success_rate:.4f} ±" in printed.err
    assert (answer["env"], answer["dialogues"], answer["mode"]) == ("domain_ext", 75, mode)


def test_a_loaded_run_plays_as_it_was_reported(commanded):
    env, policy, config, mode = load_run(commanded, dialogues=30)
    assert mode == "mean"
    assert env.round == 2
    played = evaluate_policy(env, policy, 30, seed=config.seed)
    reported = [item.success_rate for item in read_result(commanded).per_replica]
    assert played.success.double().mean(-1).tolist() == pytest.approx(reported)


def test_other_weights_than_there_are_are_refused(commanded):
    with pytest.raises(ValueError, match=r"weights must be one of last, best, got 'first'"):
        load_run(commanded, weights="first")


def test_a_policy_that_reads_the_hidden_goal_is_called_privileged(capsys):
    assert evaluate.main(["policy=clairvoyant", "dialogues=20"]) == 0
    assert json.loads(capsys.readouterr().out)["privileged"] is True


def test_a_scripted_policy_is_evaluated_and_its_dialogues_are_written(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    arguments = "policy=rule dialogues=300 batch=128 log=dialogues.txt log_dialogues=300"
    assert evaluate.main(arguments.split()) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["dialogues"], answer["turns"]) == (300, 8)
    assert "privileged" not in answer
    rate = answer["success_rate"]
    assert answer["standard_error"] == round((rate * (1 - rate) / 300) ** 0.5, 4)
    # Reward of 8 turns: -1 for the first 7, then 40 or -10.
    assert answer["reward"] == pytest.approx(-7 + 40 * rate - 10 * (1 - rate))
    log = (tmp_path / "dialogues.txt").read_text()
    assert log.count("dialogue ") == 300
    assert log.count("agent: ") == 300 * 8
    assert log.count("  success\n") == round(300 * rate)


def test_a_sweep_trains_each_agent_with_its_own_exploration_and_goes_on(
    restaurant_folder, tmp_path
):
    shutil.copytree(restaurant_folder, tmp_path / "restaurant")
    sweep = (  # the default launcher is tested, slowly, in test_launchers.py
        "--multirun hydra/launcher=basic agent=bbqn,gp,dqn hydra.job.chdir=true",
        *(*TINY, "protocol.rounds=1", "domain=folder", "domain.path=restaurant"),
        *("hydra.sweep.dir=sweep", "hydra.sweep.subdir=${hydra.job.num}"),
    )
    folders = [tmp_path / "sweep" / job for job in ("0", "2")]
    made = []
    for _ in range(2):  # what is finished is left as it is
        _, table = train(*sweep, cwd=tmp_path, code=1)
        assert table.startswith("2 of 3 runs")
        results = [read_result(folder) for folder in folders]
        assert [result.explore for result in results] == ["thompson_boltzmann", "epsilon_greedy"]
        # A job finds the domain from where the sweep began.
        assert {result.domain for result in results} == {"restaurant"}
        made.append([(folder / "config.yaml").stat().st_mtime_ns for folder in folders])
    assert made[0] == made[1]
    refused = tmp_path / "sweep" / "1"
    assert not (refused / "config.yaml").exists()
    assert "protocol.capacity" in (refused / "train.log").read_text()


def test_the_default_dtype_of_the_process_changes_nothing(commanded, tmp_path):
    torch.set_default_dtype(torch.float64)
    try:
        result = run(load_config(commanded / "config.yaml"), tmp_path)
        loaded = load_run(tmp_path)
        loaded.env.rollout(3, loaded.policy)
    finally:
        torch.set_default_dtype(torch.float32)
    assert result.per_replica == read_result(commanded).per_replica


def test_a_mean_q_that_no_return_can_have_is_warned_of_and_in_the_result(tmp_path):
    command = "agent=dqn agent.lr=10 replicas=2 hydra.run.dir=run"
    train(command, *TINY, "protocol.rounds=1", cwd=tmp_path)
    found = read_result(tmp_path / "run").warnings
    assert len(found) == 2
    assert "agent.lr" in found[0]
    log = (tmp_path / "run" / "train.log").read_text()
    assert all(log.count(text) == 1 for text in found)


@pytest.mark.parametrize(
    ("chosen", "value", "key"),
    [
        ("agent=dqn", 40.0, None),  # success at once
        ("agent=dqn", 40.1, "agent.lr"),
        ("agent=dqn", -18.0, None),  # failure, and ten turns' worth of -1 at most
        ("agent=dqn", -20.1, "agent.lr"),
        ("agent=gp", 40.1, "agent.noise_std"),
        ("agent=dqn intrinsic=vime", 99.0, None),  # a bonus of any size
    ],
)
def test_the_range_of_returns_is_that_of_rewards_and_discount(chosen, value, key):
    rows = [{"round": 3, "replica": 1, "q_value": value}]
    found = divergence(composed(*chosen.split(), "replicas=2"), rows)
    assert [*found] == ([] if key is None else [1])
    assert all(key in text for text in found.values())


def test_a_loss_that_is_not_finite_stops_the_run_with_its_state_saved(tmp_path):
    command = "agent.lr=1e30 replicas=2 hydra.run.dir=run"
    _, message = train(command, *TINY, cwd=tmp_path, code=1)
    assert "the loss of replicas 0, 1 is not finite in round 0: lower agent.lr; the" in message
    assert "Traceback" not in message
    assert (tmp_path / "run" / "checkpoint" / "failed-round-000000.torchrl").is_file()
    assert not (tmp_path / "run" / "result.json").exists()


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("agent", {"agent=dqn", "agent=gp", "agent.double=false", "agent.noise_std="}),
        ("agent=dqn", {"agent=dqn", "agent.double=false"}),
        ("agent.double", {"agent.double=false"}),
        ("seed=3", {"seed=0"}),
    ],
)
def test_help_tells_the_meaning_of_a_word(word, told):
    lines = usage([word]).splitlines()
    assert all(any(line.strip().startswith(text) for line in lines) for text in told)
    assert any("agent=gp" in line for line in lines) == ("agent=gp" in told)
    assert all(len(line.split(None, 1)[1]) > 10 for line in lines)


def test_help_refuses_what_is_no_word_of_the_command():
    with pytest.raises(ConfigError, match=r"agent\.units"):
        usage(["agent.units"])


def test_help_shows_groups_and_options_without_importing_torch(tmp_path):
    out, imported = forked.python("-X", "importtime", TRAIN, "--help", cwd=tmp_path)
    assert "protocol=" in out
    assert "  quick " in out
    assert "agents/" in out
    assert "hydra" in imported
    assert "torch" not in imported.replace("bbq_torchrl", "")
    assert not list(tmp_path.iterdir())
