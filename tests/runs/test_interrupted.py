"""Signals, killed runs and extensions: what was saved goes on."""

import json
import os
import signal

import pytest
import tiny
from tiny import composed, rows, without_drawing

from bbq_torchrl.runs.folders import is_finished, load_config
from bbq_torchrl.runs.train import run
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import RunFolderGoneError
from bbq_torchrl.utils import interruption

from .trusted import DQN

pytestmark = pytest.mark.usefixtures("without_curves")


def resumed(folder):
    """Goes on with a run as ``train.py resume=<folder>`` does, in this process."""
    return run(tiny.resumed(folder), folder)


class Killed(BaseException):
    """Ends a process: nothing more is written."""


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The configuration of a run of six rounds, and its metrics."""
    folder = tmp_path_factory.mktemp("uninterrupted") / "run"
    longer = composed(*DQN, "protocol.keep_checkpoints=last", "protocol.rounds=6")
    with without_drawing():
        run(longer, folder)
    return longer, rows(folder / "metrics.csv")


def test_an_interrupted_extension_goes_on(copy, kept, uninterrupted):
    folder = copy(kept)
    config = load_config(folder / "config.yaml")
    config.protocol.rounds, config.resume = 6, str(folder)

    def kill(trainer, rows):
        if trainer.rounds_done == 5:
            raise Killed

    with pytest.raises(Killed):
        run(config, folder, [kill])
    assert json.loads((folder / "result.json").read_text())["rounds"] == 3
    assert not is_finished(folder, 6)

    result = resumed(folder)

    assert result.rounds == 6
    assert rows(folder / "metrics.csv") == uninterrupted[1]


def test_a_run_whose_folder_is_moved_ends_at_once_and_goes_on_in_its_new_place(
    uninterrupted, tmp_path
):
    old, new = tmp_path / "old", tmp_path / "new"

    def move(trainer, rows):
        if trainer.rounds_done == 1:
            old.rename(new)

    with pytest.raises(RunFolderGoneError):
        run(uninterrupted[0], old, [move])

    assert not old.exists()
    resumed(new)
    assert rows(new / "metrics.csv") == uninterrupted[1]


def test_a_run_killed_before_its_curve_is_drawn_is_finished_by_resume(copy, finished):
    folder = copy(finished)
    (folder / "curve.png").unlink()
    result = (folder / "result.json").read_bytes()

    resumed(folder)

    assert (folder / "curve.png").is_file()
    assert (folder / "result.json").read_bytes() == result
    with pytest.raises(ConfigError, match=r"protocol\.rounds"):
        resumed(folder)


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


def test_a_signal_lets_the_round_end_and_saves_it(tmp_path, listening, kept):
    assert signal.getsignal(signal.SIGINT) is signal.getsignal(signal.SIGTERM)
    folder = tmp_path / "run"
    interruption.tell(how_to_continue=lambda: "so it continues")

    def signaled(trainer, rows):
        os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(interruption.Interrupted):
        run(composed(*DQN, "protocol.keep_checkpoints=last"), folder, [signaled])

    assert interruption.exit_code() == 128 + signal.SIGTERM
    assert interruption.line() == "interrupted after 1 of 3 rounds, 1 saved: so it continues"
    newest = max((folder / "checkpoint").iterdir()).name
    assert newest == "round-000001.torchrl"
    interruption._State.received = None
    resumed(folder)
    assert rows(folder / "metrics.csv") == rows(kept / "metrics.csv")


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
    run(composed(*DQN, "protocol.keep_checkpoints=all", "protocol.checkpoint_every=1"), tmp_path)
    assert len(list((tmp_path / "checkpoint").glob("round-*"))) == 4
