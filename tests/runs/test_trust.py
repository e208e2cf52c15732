"""A run folder: no code is run from it, one process writes it, and what is wrong is a sentence."""

import fcntl
import json
import math
import os

import forked
import pytest
from tiny import composed, nightly

import train
from bbq_torchrl.cli import evaluate
from bbq_torchrl.runs.folders import is_finished, load_config, run_config, run_lock
from bbq_torchrl.runs.train import run
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import TrainingError
from bbq_torchrl.utils.files import LOCK, PROCESS
from bbq_torchrl.utils.output import REFUSED
from bbq_torchrl.utils.reports import Report, Table

from .trusted import DQN

pytestmark = pytest.mark.usefixtures("without_curves")


def state_of(folder):
    return {
        path.relative_to(folder): (path.stat().st_mtime_ns, path.read_bytes())
        for path in folder.rglob("*")
        if path.is_file() and path.name != LOCK
    }


def refused(main, *arguments, cwd):
    """Runs a command line that is refused. Returns its one line."""
    out, err = forked.call(main, *arguments, cwd=cwd, code=REFUSED)
    assert not out
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize("name", nightly(["train.log", ".lock", "checkpoint"], ["checkpoint"]))
def test_a_run_is_not_resumed_through_a_link(copy, kept, tmp_path, name):
    folder, victim = copy(kept), tmp_path / "victim"
    (folder / name).rename(victim) if (folder / name).is_dir() else victim.write_text("mine\n")
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(victim)
    before = state_of(tmp_path)

    line = refused(train.main, f"resume={folder}", "protocol.rounds=5", cwd=tmp_path)

    assert f"{name} is a symbolic link" in line
    assert state_of(tmp_path) == before


@pytest.mark.parametrize("name", ["report.md", ".report.md.new", "runs.csv"])
def test_a_report_is_not_written_through_a_link(tmp_path, name):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / name).symlink_to(victim)

    Report("report", "A report", [Table("runs", [{"agent": "dqn"}])], {}).write(tmp_path)

    assert victim.read_text() == "mine"
    assert not any(path.is_symlink() for path in tmp_path.iterdir())
    assert (tmp_path / "runs.csv").read_text() == "agent\ndqn\n"


@pytest.mark.parametrize("value", nightly([math.nan, math.inf], [math.inf]))
def test_weights_that_are_not_finite_give_no_result_and_are_not_evaluated(tmp_path, value):
    def spoil(trainer, rows):
        if trainer.rounds_done == trainer.rounds:
            next(trainer.policy.parameters()).data.flatten()[-1] = value

    folder = tmp_path / "run"
    with pytest.raises(TrainingError, match="NaN or infinite"):
        run(composed(*DQN), folder, [spoil])
    assert not (folder / "result.json").exists()
    line = refused(evaluate.main, f"policy={folder}", "dialogues=2", cwd=tmp_path)
    assert f"{folder} has weights that are NaN or infinite (" in line


def test_an_evaluation_leaves_a_run_folder_as_it_is(copy, kept, capsys):
    folder = copy(kept)
    stage = folder / "checkpoint" / f".round-000004.torchrl.stage-{'0a' * 16}"
    stage.mkdir()
    (stage / "part").write_text("what a living process is just saving")
    before = state_of(folder)

    assert evaluate.main([f"policy={folder}", "dialogues=2"]) == 0

    assert state_of(folder) == before


def test_after_the_end_the_weights_are_left_and_evaluate_as_before(kept, finished, capsys):
    assert [path.name for path in (finished / "checkpoint").iterdir()] == ["round-000003.torchrl"]
    answers = []
    for folder in (kept, finished):
        assert evaluate.main([f"policy={folder}", "dialogues=20"]) == 0
        answers.append(json.loads(capsys.readouterr().out))
    for key in ("success_rate", "reward", "turns"):
        assert answers[0][key] == answers[1][key]


def test_a_run_of_which_the_weights_are_left_is_not_extended_and_stays_finished(
    copy, finished, tmp_path
):
    folder = copy(finished)
    before = state_of(folder)

    assert "protocol.rounds" in refused(train.main, f"resume={folder}", cwd=tmp_path)
    line = refused(train.main, f"resume={folder}", "protocol.rounds=5", cwd=tmp_path)

    assert "protocol.keep_checkpoints=last" in line
    assert state_of(folder) == before
    assert is_finished(folder, run_config(folder).protocol.rounds)


def test_a_second_process_in_a_run_folder_is_refused_until_the_first_has_ended(
    copy, kept, tmp_path
):
    folder = copy(kept)
    (folder / PROCESS).write_text("process 7 on host\n")
    before = state_of(folder)

    with (folder / LOCK).open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # of this file alone, as another process would hold it
        for command in ((f"resume={folder}", "protocol.rounds=5"), (f"hydra.run.dir={folder}",)):
            line = refused(train.main, *command, cwd=tmp_path)
            assert str(folder) in line
            assert "process 7 on host" in line
        with pytest.raises(ConfigError, match="must be free"):
            run(load_config(folder / "config.yaml"), folder)
        assert state_of(folder) == before
        assert evaluate.main([f"policy={folder}", "dialogues=2"]) == 0

    with run_lock(folder), run_lock(folder):
        assert str(os.getpid()) in (folder / PROCESS).read_text()
    assert not (folder / PROCESS).exists()
