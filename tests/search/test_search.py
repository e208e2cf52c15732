"""Trials on a made-up training: what is kept, what goes on, what is pruned, what is written."""

import dataclasses
import errno
import json
import math
import os
import shlex
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
from tiny import composed, rows

from bbq_torchrl.runs.folders import save_config
from bbq_torchrl.search.definition import compose_search
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import TrainingError

optuna = pytest.importorskip("optuna", reason="needs the extra search")
pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::optuna.exceptions.ExperimentalWarning"
)

from bbq_torchrl.search import trials as study  # noqa: E402
from bbq_torchrl.search.trials import run_search  # noqa: E402

ROUNDS = 4


def success(lr):
    return max(0.0, 1 - abs(math.log10(float(lr)) + 3))


class Training:
    """A training of four replicas, whose success is a function of the learning rate.

    It keeps the number of its rounds in its folder, as the real one does in its checkpoints.
    ``fails`` has what is raised, by trial and round.
    """

    def __init__(self, fails=()):
        self.fails, self.played = dict(fails), []

    def __call__(self, config, folder, callbacks):
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


def search(folder, *arguments, trials=4, of="dqn", training=None, **more):
    """Searches. Returns what was best."""
    defined = compose_search(
        [
            f"search={Path(__file__).with_name(f'{of}.yaml')}",
            f"protocol.rounds={ROUNDS}",
            f"search.folder={folder}",
            f"search.trials={trials}",
            "search.startup_trials=2",
            "search.objective=training",
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
    lr = composed(*overrides).agent.lr
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


def test_of_choices_alone_none_is_tried_twice(tmp_path):
    search(tmp_path, "search.pruner=none", trials=7, of="choices")
    tried = [(row["agent.lr"], row["explore.eps_init"]) for row in table(tmp_path)]
    assert len(tried) == len(set(tried)) == 3 * 2


def test_a_finished_search_is_extended_by_more_trials(tmp_path):
    search(tmp_path, trials=2)
    before, again = table(tmp_path), Training()
    search(tmp_path, trials=2, training=again)
    assert again.trials == set()
    search(tmp_path, trials=3, training=again)
    assert again.trials == {2}
    assert table(tmp_path)[:2] == before


def test_two_processes_never_work_at_the_same_trial(tmp_path, monkeypatch):
    for seconds in ("_HEARTBEAT", "_GRACE"):  # so that a silent process is soon taken for dead
        monkeypatch.setattr(study, seconds, 1)
    begun = threading.Event()

    class Slow(Training):
        def __call__(self, *given, **more):
            begun.set()
            while len(other.trials) < 3 and time.time() < end:  # another does the rest meanwhile
                time.sleep(0.05)
            time.sleep(1)  # in which the other begins no trial more than there are
            return super().__call__(*given, **more)

    end, slow, other = time.time() + 60, Slow(), Training()
    with ThreadPoolExecutor() as pool:
        first = pool.submit(search, tmp_path, training=slow)
        begun.wait(10)
        assert search(tmp_path, training=other) == first.result()
    assert (slow.trials, other.trials) == ({0}, {1, 2, 3})
    assert len(table(tmp_path)) == 4


def test_trials_that_cannot_be_run_or_diverge_fail_and_the_search_goes_on(tmp_path):
    checked = []

    def check(config):
        checked.append(config)
        if len(checked) == 2:
            raise ConfigError("protocol.capacity must be\nmore")

    training = Training({(2, 3): TrainingError("the loss is\nnot finite"), (3, 2): KeyError("x")})
    best = search(tmp_path, training=training, check=check, trials=5)
    assert [(row["state"], row["reason"]) for row in table(tmp_path)] == [
        ("complete", ""),
        ("fail", "protocol.capacity must be more"),
        ("fail", "the loss is not finite"),
        ("fail", "KeyError: 'x'"),
        ("complete", ""),
    ]
    assert training.trials == {0, 2, 3, 4}
    assert best["trial"] in (0, 4)


def test_nothing_is_best_where_no_trial_was_completed(tmp_path):
    assert search(tmp_path, trials=1, training=Training({(0, 1): TrainingError("bad")})) is None
    assert not (tmp_path / "best.json").exists()


def test_a_trial_below_the_median_of_the_others_is_stopped_after_its_grace(tmp_path):
    search(tmp_path, "search.prune_after=.5", trials=8)
    pruned = [row for row in table(tmp_path) if row["state"] == "pruned"]
    complete = [row for row in table(tmp_path) if row["state"] == "complete"]
    assert pruned
    assert {row["rounds"] for row in pruned} == {"3"}  # half of 4 rounds, and the one that tells
    assert [row["trial"] for row in complete[:2]] == ["0", "1"]
    best = max(success(row["agent.lr"]) for row in complete)
    assert all(success(row["agent.lr"]) < best for row in pruned)


def test_a_folder_is_not_used_for_another_search(tmp_path):
    search(tmp_path, trials=1)
    again = Training()
    for change in ("search.objective=final", "search.space.agent.lr.high=.1", "seed=2"):
        with pytest.raises(ConfigError, match=r"search\.folder"):
            search(tmp_path, change, trials=2, training=again)
    assert not again.played


def test_a_database_is_not_used_from_another_folder(tmp_path):
    shared = f"search.storage=sqlite:///{tmp_path / 'shared.db'}"
    search(tmp_path / "a", shared, trials=1)
    with pytest.raises(ConfigError, match=r"search\.folder"):
        search(tmp_path / "b", shared, trials=2)


def test_a_trials_folder_with_a_run_of_other_values_is_left_alone(tmp_path):
    other = tmp_path / "trial_0001"
    other.mkdir()
    save_config(composed("agent=dqn"), other / "config.yaml")
    before, training = (other / "config.yaml").read_text(), Training()
    search(tmp_path, trials=2, training=training)
    assert training.trials == {0}
    assert [row["state"] for row in table(tmp_path)] == ["complete", "fail"]
    assert (other / "config.yaml").read_text() == before


def test_the_database_lies_in_the_folder_whatever_its_name(tmp_path):
    name = "a%23b{c} é"
    search(tmp_path / name, trials=1)
    assert (tmp_path / name / "study.db").is_file()
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_full_disk_ends_the_search_and_the_next_start_goes_on(tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        search(tmp_path, trials=2, training=Training({(0, 3): full}))
    again = Training()
    search(tmp_path, trials=2, training=again)
    assert again.played[0] == (0, 3)
    assert [row["trial"] for row in table(tmp_path)] == ["0", "1"]
