"""Trials on a made-up training: what is kept, what goes on, what is pruned, what is written."""

from __future__ import annotations

import copy
import dataclasses
import errno
import json
import math
import os
import shlex
from pathlib import Path
from types import SimpleNamespace

import forked
import pytest
from filelock import FileLock, Timeout
from tiny import rows

from bbq_torchrl.cli.resume import save_config
from bbq_torchrl.cli.store import compose
from bbq_torchrl.options import ConfigError
from bbq_torchrl.search.__main__ import main
from bbq_torchrl.search.definition import Search, compose_search
from bbq_torchrl.trainers import TrainingError

optuna = pytest.importorskip("optuna", reason="needs the extra search")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

from bbq_torchrl.search.study import run_search  # noqa: E402

ROUNDS = 4


class Killed(BaseException):
    """What ends a process."""


class Diverged(TrainingError):
    """What a trial's values are to blame for."""


class Training:
    """A training whose success in each round is a function of the learning rate.

    It keeps the rounds that are done in its folder, as the real one does in its checkpoints, and
    is killed in the round ``dies_in`` = (trial, round).
    """

    def __init__(self, dies_in=None, diverges=(), error=Diverged):
        self.error = error
        self.dies_in = dies_in
        self.diverges = diverges
        self.played = []

    def __call__(self, config, folder, callbacks, *, domain):
        save_config(dataclasses.replace(config, resume=None), folder / "config.yaml")
        kept = folder / "rounds.json"
        done = json.loads(kept.read_text()) if kept.exists() else 0
        assert (config.resume is not None) == kept.exists()
        success = max(0.0, 1 - abs(math.log10(config.agent.lr) + 3))
        trial = int(folder.name.rpartition("_")[2])
        while done < ROUNDS:
            if self.dies_in == (trial, done):
                raise Killed
            if trial in self.diverges and done == 2:
                raise self.error("the loss is\nnot finite")
            done += 1
            self.played.append((trial, done))
            rows = [
                {"success_rate": success * shade} for _ in range(done) for shade in (0.9, 1.0, 1.1)
            ]
            trainer = SimpleNamespace(
                rounds_done=done,
                metrics=SimpleNamespace(rows=rows),
                rounds=ROUNDS,
            )
            for callback in callbacks:
                callback(trainer, rows[-3:])
            kept.write_text(json.dumps(done))
        return SimpleNamespace(
            per_replica=[
                SimpleNamespace(training_success=success * shade, success_rate=success / 2 * shade)
                for shade in (0.9, 1.0, 1.1)
            ]
        )


@pytest.fixture(scope="module")
def plain():
    return compose(["agent=dqn", f"protocol.rounds={ROUNDS}"])


@pytest.fixture(autouse=True)
def composed_once(plain, monkeypatch):
    """Composing takes longer than all else here, and is tested in tests/config."""

    def config(self, values):
        changed = copy.deepcopy(plain)
        changed.agent.lr = values["agent.lr"]
        changed.explore.eps_init = values["explore.eps_init"]
        return changed

    monkeypatch.setattr(Search, "config", config)


def search(folder, *arguments, trials=4, of="dqn"):
    return compose_search(
        [
            f"search={Path(__file__).with_name(f'{of}.yaml')}",
            f"protocol.rounds={ROUNDS}",
            f"search.folder={folder}",
            f"search.trials={trials}",
            "search.startup_trials=2",
            *arguments,
        ]
    )


def table(folder):
    """trials.csv without its times."""
    return rows(folder / "trials.csv")


def test_the_best_trial_is_written_down_with_the_command_that_trains_it(tmp_path):
    best = run_search(search(tmp_path, "search.pruner=none"), Training())
    rows = table(tmp_path)
    values = [float(row["value"]) for row in rows]
    assert [row["state"] for row in rows] == ["complete"] * 4
    assert best["value"] == max(values)
    assert best["trial"] == values.index(max(values))
    assert json.loads((tmp_path / "best.json").read_text()) == best
    program, script, *overrides = shlex.split(best["command"])
    assert (program, script) == ("python", "train.py")
    config = compose(overrides)
    assert config.agent.lr == best["values"]["agent.lr"] == float(rows[best["trial"]]["agent.lr"])
    assert best["value"] == pytest.approx(max(0.0, 1 - abs(math.log10(config.agent.lr) + 3)))


@pytest.mark.parametrize("trials", [5, 9])
def test_of_choices_alone_none_is_tried_twice(tmp_path, trials):
    run_search(search(tmp_path, "search.pruner=none", trials=trials, of="choices"), Training())
    tried = [(row["agent.lr"], row["explore.eps_init"]) for row in table(tmp_path)]
    assert len(tried) == len(set(tried)) == min(trials, 3 * 2)


@pytest.mark.parametrize(("of", "trial"), [("dqn", 0), ("dqn", 2), ("choices", 3)])
def test_a_search_that_was_killed_ends_as_one_that_was_not(tmp_path, of, trial):
    run_search(search(tmp_path / "whole", of=of), Training())
    parts = search(tmp_path / "parts", of=of)
    first, second = Training(dies_in=(trial, 1)), Training()
    with pytest.raises(Killed):
        run_search(parts, first)
    run_search(parts, second)
    assert table(tmp_path / "parts") == table(tmp_path / "whole")
    # Finished trials were not played again, and the killed one from where it was.
    assert second.played[0] == (trial, 2)
    assert {number for number, _ in second.played} == set(range(trial, 4))


def test_a_finished_search_is_extended_by_more_trials(tmp_path):
    run_search(search(tmp_path, trials=2), Training())
    before = table(tmp_path)
    again = Training()
    run_search(search(tmp_path, trials=2), again)
    assert again.played == []
    run_search(search(tmp_path, trials=3), again)
    assert table(tmp_path)[:2] == before
    assert {number for number, _ in again.played} == {2}


def test_two_processes_never_work_at_the_same_trial(tmp_path):
    inner = Training()

    class Meanwhile(Training):
        def __call__(self, config, folder, callbacks, *, domain):
            if not inner.played:  # while this trial is under way, another process does the rest
                run_search(search(tmp_path), inner)
            return super().__call__(config, folder, callbacks, domain=domain)

    outer = Meanwhile()
    run_search(search(tmp_path), outer)
    assert {number for number, _ in outer.played} == {0}
    assert {number for number, _ in inner.played} == {1, 2, 3}
    assert len(table(tmp_path)) == 4


def test_a_trial_that_diverges_is_noted_and_the_search_goes_on(tmp_path):
    best = run_search(search(tmp_path, trials=3), Training(diverges=[1]))
    rows = table(tmp_path)
    assert [row["state"] for row in rows] == ["complete", "fail", "complete"]
    assert rows[1]["reason"] == "the loss is not finite"
    assert best["trial"] != 1


def test_an_error_that_the_values_are_not_to_blame_for_ends_the_search(tmp_path):
    with pytest.raises(KeyError):
        run_search(search(tmp_path, trials=2), Training(diverges=[0], error=KeyError))
    run_search(search(tmp_path, trials=2), Training())
    assert [row["state"] for row in table(tmp_path)] == ["complete", "complete"]


def test_nothing_is_best_where_no_trial_was_completed(tmp_path):
    assert run_search(search(tmp_path, trials=1), Training(diverges=[0])) is None
    assert not (tmp_path / "best.json").exists()


def test_a_trial_below_the_median_of_the_others_is_stopped_after_its_grace(tmp_path):
    run_search(search(tmp_path, "search.prune_after=.5", trials=8), Training())
    rows = table(tmp_path)
    pruned = [row for row in rows if row["state"] == "pruned"]
    complete = [float(row["value"]) for row in rows if row["state"] == "complete"]
    assert pruned
    assert {int(row["rounds"]) for row in pruned} == {3}  # half of 4 rounds, and the one that tells
    assert all(row["state"] == "complete" for row in rows[:2])
    for row in pruned:
        success = max(0.0, 1 - abs(math.log10(float(row["agent.lr"])) + 3))
        assert success < max(complete)


@pytest.mark.parametrize(
    ("objective", "statistic", "share"),
    [("training", "mean", 1.0), ("training", "iqm", 1.0), ("final", "mean", 0.5)],
)
def test_the_objective_is_the_success_that_was_chosen(tmp_path, objective, statistic, share):
    chosen = [f"search.objective={objective}", f"search.statistic={statistic}"]
    best = run_search(search(tmp_path, *chosen, trials=1), Training())
    success = max(0.0, 1 - abs(math.log10(best["values"]["agent.lr"]) + 3))
    assert best["value"] == pytest.approx(share * success)


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ("search.objective=final", "search.objective=training"),
        ("search.space.agent.lr.high=.1", "search.space.agent.lr="),
        ("replicas=2", "fixed="),
    ],
)
def test_a_folder_is_not_used_for_another_search(tmp_path, changed, key):
    run_search(search(tmp_path, trials=1), Training())
    with pytest.raises(ConfigError, match="choose another") as refused:
        run_search(search(tmp_path, changed, trials=2), Training())
    assert f"holds a search with {key}" in str(refused.value)


def test_a_database_is_not_used_for_another_search_of_another_folder(tmp_path):
    shared = f"search.storage=sqlite:///{tmp_path / 'shared.db'}"
    run_search(search(tmp_path / "a", shared, trials=1), Training())
    with pytest.raises(ConfigError, match=r"choose another search\.storage") as refused:
        run_search(search(tmp_path / "b", shared, "env=domain_ext", trials=1), Training())
    assert "search.storage holds a search with fixed=" in str(refused.value)


def test_a_full_disk_ends_the_command_in_a_sentence(tmp_path, monkeypatch, capsys):
    def full(config, folder, callbacks, *, domain):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))

    monkeypatch.setattr("bbq_torchrl.run.run", full)
    space = Path(__file__).with_name("dqn.yaml")
    assert main([f"search={space}", "search.trials=2", f"search.folder={tmp_path}"]) == 1
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.startswith(f"error: {tmp_path / 'trial_0000'}: No space left on device; ")


def test_nobody_looks_for_a_trial_while_another_is_told(tmp_path, monkeypatch):
    told = []

    def tell(study, trial, value, state):
        lock = FileLock(tmp_path / ".search.lock")
        with pytest.raises(Timeout), lock.acquire(timeout=0):
            pass
        told.append(trial.number)
        return original(study, trial, value, state=state)

    original = optuna.Study.tell
    monkeypatch.setattr(optuna.Study, "tell", tell)
    run_search(search(tmp_path, trials=2), Training())
    assert told == [0, 1]


def test_values_that_cannot_be_run_fail_their_trial_and_the_search_goes_on(tmp_path):
    checked = []

    def check(config):
        checked.append(config.agent.lr)
        if len(checked) == 2:
            raise ConfigError("protocol.capacity must be\nmore")

    training = Training()
    run_search(search(tmp_path, trials=3), training, check)
    rows = table(tmp_path)
    assert [row["state"] for row in rows] == ["complete", "fail", "complete"]
    assert rows[1]["reason"] == "protocol.capacity must be more"
    assert {number for number, _ in training.played} == {0, 2}


def test_help_and_refusals_need_no_optuna(tmp_path):
    program = (
        "import sys, runpy; sys.modules['optuna'] = None; sys.argv = ['search', '--help'];"
        "runpy.run_module('bbq_torchrl.search', run_name='__main__')"
    )
    out, err = forked.python("-c", program, cwd=tmp_path)
    assert "usage: python -m bbq_torchrl.search" in out
    assert not err
