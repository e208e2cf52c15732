"""A run folder: no code is run from it, one process writes it, and every end is a sentence."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import train
from bbq_torchrl import evaluate, interruption
from bbq_torchrl.cli.command import REFUSED
from bbq_torchrl.cli.resume import is_finished, run_config
from bbq_torchrl.cli.run_lock import LOCK, run_lock
from bbq_torchrl.cli.saved import load_config, save_config
from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.sweeps import table_of_runs
from bbq_torchrl.options import ConfigError
from bbq_torchrl.run import run
from bbq_torchrl.trainers import CheckpointDamagedError

sys.path.append(str(Path(__file__).resolve().parents[1] / "trainers"))
from planted import plant

TINY = (
    "agent=dqn",
    "explore=greedy",  # no schedule, which would fall over the share of other rounds
    "env.max_turn=8",
    "agent.hidden=[8]",
    "protocol.rounds=3",
    "protocol.dialogues=2",
    "protocol.capacity=200",
    "protocol.eval_dialogues=4",
    "protocol.eval_batch=4",
    "protocol.eval_every=0",
    "spike.dialogues=2",
)


pytestmark = pytest.mark.usefixtures("without_curves")


class Killed(BaseException):
    """What ends a process."""


def killed_in(round_number):
    """A callback by which a run ends in a round as a killed one does: nothing more is written."""

    def callback(trainer, rows):
        if trainer.rounds_done == round_number + 1:
            raise Killed

    return callback


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A finished run with all that it takes to go on."""
    folder = tmp_path_factory.mktemp("kept") / "run"
    run(compose([*TINY, "protocol.keep_checkpoints=last"]), folder)
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run as it is by default: its weights are left."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    run(compose(TINY), folder)
    return folder


@pytest.fixture
def copy(tmp_path):
    def copied(folder):
        return Path(shutil.copytree(folder, tmp_path / "run"))

    return copied


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Runs a command line of train.py that is refused. Returns its one line."""
    place = tmp_path / "here"
    place.mkdir()
    monkeypatch.chdir(place)

    def command(*arguments):
        monkeypatch.setattr(sys, "argv", ["train.py", *arguments])
        with pytest.raises(SystemExit) as end:
            train.main()
        assert end.value.code == REFUSED
        return one_line(capsys)

    return command


def one_line(capsys):
    out, err = capsys.readouterr()
    assert not out
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


def evaluation_refused(capsys, folder):
    capsys.readouterr()
    assert evaluate.main([f"policy={folder}", "dialogues=2"]) == 2
    return one_line(capsys)


def state_of(folder):
    return {
        path.relative_to(folder): (path.stat().st_mtime_ns, path.read_bytes())
        for path in folder.rglob("*")
        if path.is_file() and path.name != LOCK
    }


def rows(folder):
    with (folder / "metrics.csv").open(newline="") as file:
        return [
            {name: value for name, value in row.items() if not name.startswith("seconds")}
            for row in csv.DictReader(file)
        ]


def resumed(folder, *overrides):
    """Goes on with a run as ``train.py resume=<folder>`` does, in this process."""
    from bbq_torchrl.cli.resume import resumed_config

    arguments = [f"resume={folder}", *overrides]
    return run(resumed_config(compose(arguments), arguments), folder)


@pytest.mark.parametrize("file", ["other.pickle", "pickle.pkl"])
def test_neither_evaluate_nor_resume_runs_what_is_planted(
    copy, kept, refused, capsys, tmp_path, file
):
    folder = copy(kept)
    for archive in (folder / "checkpoint").iterdir():
        plant(archive, tmp_path / "marker", file)

    assert "every checkpoint in" in evaluation_refused(capsys, folder)
    assert "every checkpoint in" in refused(f"resume={folder}", "protocol.rounds=5")
    assert not (tmp_path / "marker").exists()


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
    copy, finished, refused
):
    folder = copy(finished)
    before = state_of(folder)

    assert "is finished (3 rounds)" in refused(f"resume={folder}")
    line = refused(f"resume={folder}", "protocol.rounds=5")

    assert "protocol.keep_checkpoints=last" in line
    assert state_of(folder) == before
    assert is_finished(folder, run_config(folder).protocol.rounds)


def test_an_interrupted_extension_goes_on(copy, kept, tmp_path):
    folder = copy(kept)
    longer = compose([*TINY, "protocol.keep_checkpoints=last", "protocol.rounds=6"])
    run(longer, tmp_path / "uninterrupted")

    config = load_config(folder / "config.yaml")
    config.protocol.rounds, config.resume = 6, str(folder)
    with pytest.raises(Killed):
        run(config, folder, [killed_in(4)])
    assert json.loads((folder / "result.json").read_text())["rounds"] == 3
    (folder / ".hydra").mkdir()
    assert table_of_runs(folder.parent, 0).startswith("0 of 1 runs")

    result = resumed(folder)

    assert result.rounds == 6
    assert rows(folder) == rows(tmp_path / "uninterrupted")


def test_a_run_killed_before_its_curve_is_drawn_is_finished_by_resume(copy, finished):
    folder = copy(finished)
    (folder / "curve.png").unlink()
    result = (folder / "result.json").read_bytes()

    resumed(folder)

    assert (folder / "curve.png").is_file()
    assert (folder / "result.json").read_bytes() == result
    with pytest.raises(ConfigError, match="is finished"):
        resumed(folder)


@pytest.mark.parametrize("lost", ["checkpoint", "checkpoint/*", "checkpoint and metrics.csv"])
def test_a_run_that_lost_its_checkpoints_does_not_begin_anew(copy, kept, refused, lost):
    folder = copy(kept)
    if lost == "checkpoint/*":
        for path in (folder / "checkpoint").iterdir():
            path.unlink()
    else:
        shutil.rmtree(folder / "checkpoint")
    if "metrics" in lost:
        (folder / "metrics.csv").unlink()
    before = state_of(folder)

    line = refused(f"resume={folder}", "protocol.rounds=5")

    assert "no checkpoint to go on from" in line
    assert "start a new run" in line
    assert state_of(folder) == before


def test_a_job_that_lost_its_checkpoints_does_not_begin_anew(copy, kept):
    folder = copy(kept)
    shutil.rmtree(folder / "checkpoint")
    (folder / "result.json").unlink()
    config = load_config(folder / "config.yaml")
    config.resume = str(folder)

    with pytest.raises(CheckpointDamagedError, match="no checkpoint to go on from"):
        run(config, folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("seed: 0", "seed: 5"), "seed must be 0, as in the checkpoint"),
        (("replicas: 1", "replicas: 2"), "replicas must be 1, as in the checkpoint"),
        (("gamma: 0.9", "gamma: 0.8"), "agent.gamma must be 0.9, as in the checkpoint"),
        (("capacity: 200", "capacity: 100"), "protocol.capacity must be 200, as in the checkpoint"),
    ],
)
def test_a_checkpoint_of_another_seed_or_configuration_is_refused(
    copy, kept, capsys, change, message
):
    folder = copy(kept)
    text = (folder / "config.yaml").read_text()
    assert change[0] in text
    (folder / "config.yaml").write_text(text.replace(*change))

    assert message in evaluation_refused(capsys, folder)
    with pytest.raises(ValueError, match=message):
        resumed(folder, "protocol.rounds=5")


@pytest.mark.parametrize("damage", ["cut", "foreign", "empty"])
def test_an_evaluation_of_a_damaged_checkpoint_ends_in_a_line(
    copy, finished, capsys, damage, tmp_path
):
    folder = copy(finished)
    archive = folder / "checkpoint" / "round-000003.torchrl"
    content = archive.read_bytes()
    archive.write_bytes({"cut": content[:-100], "foreign": b"PK\3\4 no", "empty": b""}[damage])

    assert "every checkpoint in" in evaluation_refused(capsys, folder)


@pytest.mark.parametrize("place", ["file", "file/run", "/proc/run"])
def test_a_run_folder_that_cannot_be_is_refused(refused, tmp_path, place):
    (tmp_path / "here" / "file").write_text("a file")

    line = refused(*TINY, f"hydra.run.dir={place}")

    assert f"{place} cannot be used as a run folder" in line


@pytest.fixture
def holder():
    """Starts a process that holds the lock of a run folder until it is killed."""
    started = []

    def hold(folder):
        code = (
            "import fcntl, sys, time; file = open(sys.argv[1], 'a');"
            "fcntl.flock(file, fcntl.LOCK_EX); print('held', flush=True); time.sleep(600)"
        )
        process = subprocess.Popen(
            [sys.executable, "-c", code, str(folder / LOCK)], stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield hold
    for process in started:
        process.kill()
        process.communicate()


def test_a_second_process_in_a_run_folder_is_refused_until_the_first_is_dead(
    copy, kept, refused, holder, capsys
):
    folder = copy(kept)
    process = holder(folder)
    before = state_of(folder)

    assert "another process is at work in" in refused(f"resume={folder}", "protocol.rounds=5")
    assert "another process is at work in" in refused(*TINY, f"hydra.run.dir={folder}")
    with pytest.raises(ConfigError, match="another process is at work in"):
        run(load_config(folder / "config.yaml"), folder)
    assert state_of(folder) == before
    assert evaluate.main([f"policy={folder}", "dialogues=2"]) == 0
    process.kill()
    process.wait()

    with run_lock(folder), run_lock(folder):
        pass


def test_a_new_run_in_the_folder_of_another_names_the_way(copy, kept, refused):
    folder = copy(kept)
    line = refused(*TINY, f"hydra.run.dir={folder}")
    assert f"already holds a run; go on with it by resume={folder}" in line


@pytest.fixture
def listening():
    """Has signals end a run in good order, in this process, and then as before."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, signal.SIG_DFL) for number in numbers}
    interruption.listen()
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
    interruption._State.received = None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_lets_the_round_end_and_saves_it(tmp_path, listening, kept, number):
    folder = tmp_path / "run"
    interruption.tell(how_to_go_on=lambda: "so it goes on")

    def signalled(trainer, rows):
        os.kill(os.getpid(), number)

    with pytest.raises(interruption.Interrupted) as end:
        run(compose([*TINY, "protocol.keep_checkpoints=last"]), folder, [signalled])

    assert end.value.exit_code == 128 + number
    assert interruption.line() == "interrupted after 1 of 3 rounds, 1 saved: so it goes on"
    newest = max((folder / "checkpoint").iterdir()).name
    assert newest == "round-000001.torchrl"
    interruption._State.received = None
    resumed(folder)
    assert rows(folder) == rows(kept)


def test_who_handles_a_signal_already_goes_on_handling_it():
    before = signal.signal(signal.SIGTERM, own := lambda number, frame: None)
    before_int = signal.getsignal(signal.SIGINT)
    try:
        interruption.listen()
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGTERM, before)
        signal.signal(signal.SIGINT, before_int)


def test_every_checkpoint_is_kept_on_request(tmp_path):
    run(compose([*TINY, "protocol.keep_checkpoints=all", "protocol.checkpoint_every=1"]), tmp_path)
    assert len(list((tmp_path / "checkpoint").glob("round-*"))) == 4


def test_a_disk_without_room_is_an_error_before_the_first_byte(kept, monkeypatch):
    """A memory map on a full disk is no error, it kills: so room is taken first."""
    from bbq_torchrl.trainers import CheckpointFolder

    def full(descriptor, offset, length):
        assert length >= 1 << 20
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    folder = CheckpointFolder(kept / "checkpoint")
    before = state_of(kept)
    with pytest.raises(OSError, match="No space left on device"):
        folder.save(9, {})
    assert state_of(kept) == before


def test_saved_configurations_of_earlier_versions_are_read(tmp_path):
    save_config(compose(TINY), tmp_path / "config.yaml")
    text = (tmp_path / "config.yaml").read_text()
    (tmp_path / "config.yaml").write_text(text.replace("  keep_checkpoints: weights\n", ""))
    assert load_config(tmp_path / "config.yaml").protocol.keep_checkpoints == "weights"
