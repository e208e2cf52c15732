"""Trials on a made-up training: what is kept, what goes on, what is pruned, what is written."""

from __future__ import annotations

import copy
import dataclasses
import errno
import json
import math
import os
import shlex
import sqlite3
from pathlib import Path
from types import SimpleNamespace

import forked
import pytest
from filelock import FileLock, Timeout
from tiny import rows

from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.resume import save_config
from bbq_torchrl.search.__main__ import main
from bbq_torchrl.search.definition import Search, compose_search
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import TrainingError

optuna = pytest.importorskip("optuna", reason="needs the extra search")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

from sqlalchemy import event  # noqa: E402
from sqlalchemy.pool import Pool  # noqa: E402

from bbq_torchrl.search.study import run_search  # noqa: E402

ROUNDS = 4


class Killed(BaseException):
    """Ends a process as a kill would."""


def success(lr):
    return max(0.0, 1 - abs(math.log10(float(lr)) + 3))


class Training:
    """A training of four replicas, whose success is a function of the learning rate.

    It keeps the number of its rounds in its folder, as the real one does in its checkpoints.
    ``fails`` has what is raised, by trial and round.
    """

    def __init__(self, fails=()):
        self.fails, self.played = dict(fails), []

    def __call__(self, config, folder, callbacks, *, domain):
        save_config(dataclasses.replace(config, resume=None), folder / "config.yaml")
        kept, trial = folder / "rounds.json", int(folder.name.removeprefix("trial_"))
        assert (config.resume is not None) == kept.exists()
        done = json.loads(kept.read_text()) if kept.exists() else 0
        replicas = [success(config.agent.lr) * shade for shade in (0.9, 1.0, 1.0, 1.5)]
        rows = [{"success_rate": rate} for rate in replicas]
        for number in range(done + 1, ROUNDS + 1):
            if (trial, number) in self.fails:
                raise self.fails[trial, number]
            self.played.append((trial, number))
            metrics = SimpleNamespace(rows=rows * number)
            trainer = SimpleNamespace(rounds_done=number, rounds=ROUNDS, metrics=metrics)
            for callback in callbacks:
                callback(trainer, rows)
            kept.write_text(json.dumps(number))
        results = [SimpleNamespace(training_success=r, success_rate=r / 2) for r in replicas]
        return SimpleNamespace(per_replica=results)

    @property
    def trials(self):
        return {trial for trial, _ in self.played}


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


def search(folder, *arguments, trials=4, of="dqn", training=None, **more):
    """Searches. Returns what was best."""
    defined = compose_search(
        [
            f"search={Path(__file__).with_name(f'{of}.yaml')}",
            f"protocol.rounds={ROUNDS}",
            f"search.folder={folder}",
            f"search.trials={trials}",
            "search.startup_trials=2",
            *arguments,
        ]
    )
    return run_search(defined, training or Training(), **more)


def table(folder):
    return rows(folder / "trials.csv")


def test_the_best_trial_is_written_down_with_the_command_that_trains_it(tmp_path):
    best = search(tmp_path, "search.pruner=none")
    values = [float(row["value"]) for row in table(tmp_path)]
    assert [row["state"] for row in table(tmp_path)] == ["complete"] * 4
    assert (best["value"], best["trial"]) == (max(values), values.index(max(values)))
    assert json.loads((tmp_path / "best.json").read_text()) == best
    program, script, *overrides = shlex.split(best["command"])
    assert (program, script) == ("python", "train.py")
    lr = compose(overrides).agent.lr
    assert lr == best["values"]["agent.lr"] == float(table(tmp_path)[best["trial"]]["agent.lr"])


@pytest.mark.parametrize(
    ("objective", "statistic", "share"),
    [("training", "mean", 1.1), ("training", "iqm", 1.0), ("final", "mean", 0.55)],
)
def test_the_objective_is_the_success_that_was_chosen(tmp_path, objective, statistic, share):
    chosen = [f"search.objective={objective}", f"search.statistic={statistic}"]
    best = search(tmp_path, *chosen, trials=1)
    assert best["value"] == pytest.approx(share * success(best["values"]["agent.lr"]))


def test_the_early_objective_counts_the_first_third_of_the_rounds_twice(tmp_path):
    def training(config, folder, callbacks, **more):
        rows = [
            f"{number},{replica},50,{number / 10 + replica / 100}"
            for number in range(6)
            for replica in range(2)
        ]
        text = "\n".join(["round,replica,dialogues,success_rate", *rows, ""])
        (folder / "metrics.csv").write_text(text)
        whole = [SimpleNamespace(training_success=rate, success_rate=0) for rate in (0.25, 0.26)]
        return SimpleNamespace(per_replica=whole)

    best = search(tmp_path, "search.objective=early", trials=1, training=training)
    # Two of six rounds: .05 and .06 of the replicas; all six: .25 and .26.
    assert best["value"] == pytest.approx((0.15 + 0.16) / 2)


@pytest.mark.parametrize("trials", [5, 9])
def test_of_choices_alone_none_is_tried_twice(tmp_path, trials):
    search(tmp_path, "search.pruner=none", trials=trials, of="choices")
    tried = [(row["agent.lr"], row["explore.eps_init"]) for row in table(tmp_path)]
    assert len(tried) == len(set(tried)) == min(trials, 3 * 2)


@pytest.mark.parametrize(("of", "trial"), [("dqn", 0), ("dqn", 2), ("choices", 3)])
def test_a_search_that_was_killed_ends_as_one_that_was_not(tmp_path, of, trial):
    search(tmp_path / "whole", of=of)
    with pytest.raises(Killed):
        search(tmp_path / "parts", of=of, training=Training({(trial, 2): Killed}))
    again = Training()
    search(tmp_path / "parts", of=of, training=again)
    assert table(tmp_path / "parts") == table(tmp_path / "whole")
    # Finished trials were not played again, and the killed one from where it was.
    assert again.played[0] == (trial, 2)
    assert again.trials == set(range(trial, 4))


def test_a_finished_search_is_extended_by_more_trials(tmp_path):
    search(tmp_path, trials=2)
    before, again = table(tmp_path), Training()
    search(tmp_path, trials=2, training=again)
    assert again.trials == set()
    search(tmp_path, trials=3, training=again)
    assert again.trials == {2}
    assert table(tmp_path)[:2] == before


def test_two_processes_never_work_at_the_same_trial(tmp_path):
    inner = Training()

    class Meanwhile(Training):
        def __call__(self, *given, **more):
            if not inner.played:  # while this trial is under way, another process does the rest
                search(tmp_path, training=inner)
            return super().__call__(*given, **more)

    outer = Meanwhile()
    search(tmp_path, training=outer)
    assert (outer.trials, inner.trials) == ({0}, {1, 2, 3})
    assert len(table(tmp_path)) == 4


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
    search(tmp_path, trials=2)
    assert told == [0, 1]


def test_trials_that_cannot_be_run_or_diverge_fail_and_the_search_goes_on(tmp_path):
    checked = []

    def check(config):
        checked.append(config)
        if len(checked) == 2:
            raise ConfigError("protocol.capacity must be\nmore")

    training = Training({(2, 3): TrainingError("the loss is\nnot finite")})
    best = search(tmp_path, training=training, check=check)
    assert [(row["state"], row["reason"]) for row in table(tmp_path)] == [
        ("complete", ""),
        ("fail", "protocol.capacity must be more"),
        ("fail", "the loss is not finite"),
        ("complete", ""),
    ]
    assert training.trials == {0, 2, 3}
    assert best["trial"] in (0, 3)


def test_nothing_is_best_where_no_trial_was_completed(tmp_path):
    assert search(tmp_path, trials=1, training=Training({(0, 1): TrainingError("bad")})) is None
    assert not (tmp_path / "best.json").exists()


def test_an_error_that_the_values_are_not_to_blame_for_ends_the_search(tmp_path):
    with pytest.raises(KeyError):
        search(tmp_path, trials=2, training=Training({(0, 3): KeyError}))
    search(tmp_path, trials=2)
    assert [row["state"] for row in table(tmp_path)] == ["complete", "complete"]


def test_a_trial_below_the_median_of_the_others_is_stopped_after_its_grace(tmp_path):
    search(tmp_path, "search.prune_after=.5", trials=8)
    pruned = [row for row in table(tmp_path) if row["state"] == "pruned"]
    complete = [row for row in table(tmp_path) if row["state"] == "complete"]
    assert pruned
    assert {row["rounds"] for row in pruned} == {"3"}  # half of 4 rounds, and the one that tells
    assert [row["trial"] for row in complete[:2]] == ["0", "1"]
    best = max(success(row["agent.lr"]) for row in complete)
    assert all(success(row["agent.lr"]) < best for row in pruned)


@pytest.mark.parametrize(
    ("changed", "folder", "sentence"),
    [
        ("search.objective=final", "a", "a has a search with search.objective=training"),
        ("search.space.agent.lr.high=.1", "a", "a has a search with search.space.agent.lr="),
        ("replicas=2", "a", "a has a search with fixed="),
        ("env=domain_ext", "b", "search.storage has a search with fixed="),
    ],
)
def test_a_folder_or_database_is_not_used_for_another_search(tmp_path, changed, folder, sentence):
    shared = f"search.storage=sqlite:///{tmp_path / 'shared.db'}"
    search(tmp_path / "a", shared, trials=1)
    with pytest.raises(ConfigError, match="choose another search") as refused:
        search(tmp_path / folder, shared, changed, trials=2)
    assert sentence in str(refused.value)


def test_a_database_that_does_not_know_the_folders_trials_is_refused(tmp_path):
    whole = tmp_path / "whole"
    search(whole, trials=2)
    before, again = (whole / "trials.csv").read_text(), Training()
    (whole / "study.db").unlink()
    gone = r"whole has trials that .*whole/study\.db lacks: choose another search\.folder$"
    with pytest.raises(ConfigError, match=gone):
        search(whole, trials=2, training=again)
    new = f"search.storage=sqlite:///{tmp_path / 'new.db'}"
    with pytest.raises(ConfigError, match=r"has trials that search\.storage=.* lacks"):
        search(whole, new, trials=2, training=again)
    assert not again.played
    assert (whole / "trials.csv").read_text() == before


def test_a_database_of_another_folder_is_refused(tmp_path):
    shared, again = f"search.storage=sqlite:///{tmp_path / 'shared.db'}", Training()
    search(tmp_path / "a", shared, trials=1)
    search(tmp_path / "b", trials=1)
    for folder in ("b", "new"):
        refusal = r"has the search of another folder than .*: choose another search\.folder$"
        with pytest.raises(ConfigError, match=refusal):
            search(tmp_path / folder, shared, trials=2, training=again)
    assert not again.played
    search(tmp_path / "a", shared, trials=2, training=again)
    assert again.trials == {1}


def test_a_search_whose_folder_and_database_have_no_mark_goes_on(tmp_path):
    search(tmp_path, trials=1)
    (tmp_path / ".study").unlink()
    with sqlite3.connect(tmp_path / "study.db") as database:
        database.execute("DELETE FROM study_user_attributes WHERE key = 'tie'")
    database.close()
    again = Training()
    search(tmp_path, trials=2, training=again)
    assert again.trials == {1}


def test_a_trials_folder_with_a_run_of_other_values_is_refused(tmp_path, plain):
    search(tmp_path, trials=1)
    other = tmp_path / "trial_0001"
    other.mkdir()
    save_config(plain, other / "config.yaml")
    training = Training()
    with pytest.raises(ConfigError, match="trial_0001 already holds another run: choose another"):
        search(tmp_path, trials=2, training=training)
    assert not training.played
    assert [row["trial"] for row in table(tmp_path)] == ["0"]


@pytest.mark.parametrize("name", ["a%23b", "a#b", "a?b", "a{b} é"])
def test_the_database_lies_in_the_folder_whatever_its_name(tmp_path, name):
    search(tmp_path / name, trials=1)
    assert (tmp_path / name / "study.db").is_file()
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.fixture
def connections():
    """The connections that SQLAlchemy opens to SQLite: kept, so that none is closed by chance."""
    opened = []

    def keep(connection, record):
        opened.append(connection)

    event.listen(Pool, "connect", keep)
    yield opened
    event.remove(Pool, "connect", keep)


@pytest.mark.parametrize("ends", ["well", "refused", "error", "no database"])
@pytest.mark.parametrize("storage", [[], ["search.storage=sqlite:///{folder}/other.db"]])
def test_every_connection_to_the_database_is_closed(tmp_path, connections, storage, ends):
    given = [text.format(folder=tmp_path) for text in storage]
    if ends == "well":
        search(tmp_path, *given, trials=1)
    elif ends == "refused":
        search(tmp_path, *given, trials=1)
        with pytest.raises(ConfigError):
            search(tmp_path, *given, "replicas=2", trials=2)
    elif ends == "error":
        with pytest.raises(KeyError):
            search(tmp_path, *given, trials=1, training=Training({(0, 1): KeyError}))
    else:
        (tmp_path / ("other.db" if storage else "study.db")).write_text("no database")
        with pytest.raises(ConfigError, match="cannot be used"):
            search(tmp_path, *given, trials=1)
    assert connections
    for connection in connections:
        with pytest.raises(sqlite3.ProgrammingError, match="closed"):
            connection.execute("SELECT 1")


def test_a_full_disk_ends_the_command_in_a_sentence(tmp_path, monkeypatch, capsys):
    def full(config, folder, callbacks, *, domain):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))

    monkeypatch.setattr("bbq_torchrl.runs.train.run", full)
    space = Path(__file__).with_name("dqn.yaml")
    assert main([f"search={space}", "search.trials=2", f"search.folder={tmp_path}"]) == 1
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.startswith(f"error: {tmp_path / 'trial_0000'}: No space left on device; ")


def test_help_and_refusals_need_no_optuna(tmp_path):
    program = (
        "import sys, runpy; sys.modules['optuna'] = None; sys.argv = ['search', '--help'];"
        "runpy.run_module('bbq_torchrl.search', run_name='__main__')"
    )
    out, err = forked.python("-c", program, cwd=tmp_path)
    assert "usage: python -m bbq_torchrl.search" in out
    assert not err
