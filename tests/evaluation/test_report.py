"""Runs are found, compared with the first of them, and reported."""

import pytest
from result_folders import metrics_text, run_result
from tiny import rows

from bbq_torchrl.evaluation.finished_runs import find_runs

GOOD = [0.70, 0.80, 0.75, 0.72, 0.78]


def test_runs_are_found_once_in_the_order_of_places_and_numbers(add, tmp_path):
    folders = [add([0.5], name) for name in ("2_dqn", "5²", "10_bbqn")]
    folders.append(add([0.5], "sweep/deeper/1", seed=1))
    found, _ = find_runs([tmp_path / "runs", folders[0], folders[3]])
    assert found == [folder.resolve() for folder in folders]
    found, _ = find_runs([folders[2], tmp_path / "runs"])
    assert found[:2] == [folders[2].resolve(), folders[0].resolve()]


def test_runs_without_a_result_are_told_apart_wherever_they_stand(add, tmp_path):
    finished = add([0.5], "1")
    stopped, failed, waiting = (add([0.5], name, seed=1) for name in ("2", "3", "10"))
    for folder in (stopped, failed, waiting):
        (folder / "result.json").unlink()
    (failed / "metrics.csv").unlink()
    (waiting / "metrics.csv").unlink()
    (waiting / ".hydra").mkdir()
    (waiting / "config.yaml").rename(waiting / ".hydra" / "config.yaml")
    for other in (finished / "wandb" / "files", tmp_path / "other" / ".hydra"):
        other.mkdir(parents=True)
        (other / "config.yaml").write_text("lr: 1")  # of another program
    left_out = [folder.resolve() for folder in (stopped, failed, waiting)]
    for places in ([tmp_path], [finished, stopped, failed, waiting]):
        assert find_runs(places) == ([finished.resolve()], left_out)
    (tmp_path / "empty").mkdir()
    for places in ([stopped], [finished, tmp_path / "empty"], [tmp_path / "other"]):
        with pytest.raises(ValueError, match="run"):
            find_runs(places)


def test_a_report_is_printed_and_written_in_sections_of_a_key(add, report, tmp_path):
    envs = ("full", "domain_ext")
    for env in envs:
        add(GOOD, changes={"env.name": env})
        add(GOOD, agent="dqn", changes={"env.name": env})
    out = tmp_path / "report"
    printed = report("--by", "env.name", "--out", str(out))
    full, extension = printed.split("## env.name=")[1:]
    assert full.startswith("full\n\n| agent |")
    assert extension.count("| DQN |") == full.count("| DQN |") == 2
    text = (out / "report.md").read_text()
    assert text.startswith(printed)
    assert "](curves.png)" in text
    tables = [f"{name}_env.name_{env}.csv" for name in ("report", "pairs") for env in envs]
    figures = [f"{name}.{kind}" for name in ("curves", "success") for kind in ("png", "svg")]
    names = {*tables, *figures, "report.md", "replicas.csv"}
    assert {file.name for file in out.iterdir()} == names
    assert (out / "curves.png").read_bytes().startswith(b"\x89PNG")
    replicas = rows(out / "replicas.csv")
    assert len(replicas) == 20
    keys = ("corpus", "env", "replica", "seed", "rounds", "success_rate", "reward", "turns")
    first = ["movie", "full", "0", "0", "3", "0.7", "10.0", "8.0"]
    assert [replicas[0][key] for key in keys] == first
    assert replicas[0]["cumulative_success"] == "0.35"
    assert (replicas[0]["updates"], replicas[0]["commit"]) == ("", "unknown")
    assert "env.names" in report("--by", "env.names", code=2)


def test_one_setting_has_no_pairs_and_none_of_an_earlier_report_stay(add, report, tmp_path):
    add(GOOD)
    (tmp_path / "pairs.csv").write_text("of another report")
    assert "minus BBQN-MAP" not in report("--out", str(tmp_path))
    assert not (tmp_path / "pairs.csv").exists()


def test_runs_that_are_not_finished_are_named_and_break_no_report(add, report):
    add(GOOD)
    killed = add(GOOD, seed=1)
    (killed / "result.json").unlink()
    # To more rounds: its metrics are of one more than the result is of.
    extended = add(GOOD, seed=2, changes={"protocol.rounds": 5})
    (extended / "metrics.csv").write_text(metrics_text(GOOD, rounds=4))
    text = report()
    named = text.split("\n\n| agent |")[0]
    assert str(killed) in named
    assert str(extended) in named
    assert "| BBQN-MAP | thompson | 5 |" in text
    assert "| 10.71 |" in text  # the paper's reward


def test_a_result_says_which_commit_it_is_of():
    commits = [("c33954a" + 33 * "0", True), (None, None), ("5b76220" + 33 * "1", False)]
    results = [run_result([0.5], commit=commit, clean=clean) for commit, clean in commits]
    assert [result.code for result in results] == ["c33954a", "unknown", "5b76220 (changed)"]
