"""Runs are found, and a report on them is written in every form."""

from __future__ import annotations

import json

import pytest
from result_folders import metrics_text
from scipy import stats
from tiny import rows

from bbq_torchrl.evaluation import estimate, estimate_iqm, interquartile_mean
from bbq_torchrl.evaluation.comparison import comparison_report, success_table
from bbq_torchrl.evaluation.finished_runs import find_results, find_unfinished
from bbq_torchrl.evaluation.groups import read_groups

GOOD = [0.70, 0.80, 0.75, 0.72, 0.78]
BAD = [0.50, 0.40, 0.60, 0.55, 0.45]


def test_results_are_found_once_in_the_order_of_their_numbers(add, tmp_path):
    folders = [add([0.5], name) for name in ("2_dqn", "5²", "10_bbqn")]
    folders.append(add([0.5], "sweep/deeper/1", seed=1))
    found = find_results([tmp_path / "runs", folders[0], folders[3]])
    assert found == [folder.resolve() for folder in folders]


def test_runs_without_a_result_are_named_wherever_they_stand(add, tmp_path):
    finished = add([0.5], "1")
    stopped, failed, waiting = (add([0.5], name, seed=1) for name in ("2", "3", "10"))
    for folder in (stopped, failed, waiting):
        (folder / "result.json").unlink()
    (failed / "metrics.csv").unlink()
    (waiting / "metrics.csv").unlink()
    (waiting / ".hydra").mkdir()
    (waiting / "config.yaml").rename(waiting / ".hydra" / "config.yaml")
    left_out = [folder.resolve() for folder in (stopped, failed, waiting)]
    for other in (finished / "wandb" / "files", tmp_path / "other" / ".hydra"):
        other.mkdir(parents=True)
        (other / "config.yaml").write_text("lr: 1")  # of another program
    for places in ([tmp_path], [finished, stopped, failed, waiting]):
        assert find_results(places) == [finished.resolve()]
        assert find_unfinished(places) == left_out
    with pytest.raises(ValueError, match=r"holds no finished run: no result\.json is in or below"):
        find_results([stopped])
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="empty holds no finished run"):
        find_results([finished, tmp_path / "empty"])


def test_a_table_has_the_statistics_of_each_group_and_its_csv_all_digits(add, tmp_path):
    runs = [add(GOOD), add(BAD[:3], agent="dqn"), add(BAD[:1], agent="dqn", noisy=True)]
    table = success_table(read_groups(runs))
    low, high = stats.t.interval(0.95, 4, sum(GOOD) / 5, stats.sem(GOOD))
    row = str(table).splitlines()[2]
    assert row.startswith("| BBQN-MAP | thompson | 5 | 3 | ")
    assert f"| 0.750 [{low:.3f}, {high:.3f}] | {estimate_iqm(GOOD)} |" in row
    assert row.endswith(f"| {estimate([rate / 2 for rate in GOOD])} | 10.00 | 8.00 |")
    table.write(tmp_path)
    five, three, one = rows(tmp_path / "report.csv")
    assert float(five["final_success_low"]) == pytest.approx(low)
    assert float(five["cumulative_training_success"]) == pytest.approx(sum(GOOD) / 10)
    # Few seeds have no bootstrap interval, and one has none at all.
    assert float(three["iqm"]) == pytest.approx(interquartile_mean(BAD[:3]))
    assert three["iqm_low"] == one["final_success_low"] == ""
    assert float(three["final_success_low"]) < 0.5 == float(one["final_success"])


TABLE1 = {f"table1_{env}{end}" for env in ("full", "domain_ext") for end in ("", "_pairs")}
GRID = {
    f"grid_{quantity}{end}" for quantity in ("final", "cumulative") for end in ("", "_by_learner")
}


@pytest.mark.parametrize(
    ("form", "setting", "tables", "figure"),
    [
        ("report", {"agent": "dqn"}, {"report", "pairs", "learning"}, "curves"),
        ("table1", {"agent": "dqn"}, TABLE1, "table1_full"),
        ("grid", {"explore": "greedy"}, GRID, "grid"),
        ("ablations", {"prior_std": 0.3}, {"ablations_agent.prior_std"}, "ablations"),
    ],
)
def test_a_report_is_written_as_markdown_csv_png_and_svg(
    add, report, tmp_path, form, setting, tables, figure
):
    add(GOOD)
    add(GOOD, **setting)
    out = tmp_path / "report"
    printed = report(*([] if form == "report" else [f"--{form}"]), "--out", str(out))
    text = (out / f"{form}.md").read_text()
    assert text.startswith(printed)
    assert f"]({figure}.png)" in text
    assert {file.stem for file in out.glob("*.csv")} == {*tables, "replicas"}
    assert len(rows(out / "replicas.csv")) == 10
    for kind, start in (("png", b"\x89PNG"), ("svg", b"<?xml")):
        (picture,) = out.glob(f"*.{kind}")
        assert picture.stem == figure
        assert picture.read_bytes().startswith(start)


def test_one_setting_has_no_pairs_and_none_of_an_earlier_report_stay(add, report, tmp_path):
    add(GOOD)
    (tmp_path / "pairs.csv").write_text("of another report")
    assert "pairs" not in report("--out", str(tmp_path))
    assert not (tmp_path / "pairs.csv").exists()


def test_a_figure_holds_seven_groups_and_the_next_one_the_rest(add):
    runs = [add([0.5], lr=0.1 * (n + 1)) for n in range(8)]
    assert list(comparison_report(read_groups(runs)).figures) == ["curves", "curves_2"]


@pytest.mark.parametrize("state", ["killed", "extended"])
def test_a_run_that_is_not_finished_is_named_and_breaks_no_report(add, report, state):
    add(GOOD)
    if state == "killed":
        folder = add(GOOD, seed=1)
        (folder / "result.json").unlink()
    else:  # to more rounds: its metrics are of one more than the result is of
        folder = add(GOOD, seed=1, changes={"protocol.rounds": 5})
        (folder / "metrics.csv").write_text(metrics_text(GOOD, rounds=4))
    text = report()
    assert f"\n\nLeft out, since not finished: {folder}.\n\n| agent |" in text
    assert "| BBQN-MAP | thompson | 5 |" in text


def ran_by(folder, commit, *, clean):
    """Says in a result which commit made it. Returns the folder."""
    file = folder / "result.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"commit": commit, "clean": clean}))
    return folder


def test_a_report_says_which_commits_the_runs_are_of(add, report, tmp_path):
    one, other = "c33954a" + 33 * "0", "5b76220" + 33 * "1"
    assert "commit" not in report(runs=[add(GOOD, name="older")])
    bbqn, again = (ran_by(add(GOOD, seed=seed), one, clean=True) for seed in (1, 2))
    text = report(runs=[bbqn, again])
    assert "All runs are of commit c33954a." in text
    assert "| turns | commit |" in text
    assert "| 8.00 | c33954a |" in text
    dqn = ran_by(add(BAD, agent="dqn"), other, clean=False)
    text = report("--out", str(tmp_path / "out"), runs=[bbqn, again, dqn])
    assert text.endswith(
        "The runs are of different commits:\n\n- c33954a: BBQN-MAP\n- 5b76220 (changed): DQN\n"
    )
    kept = rows(tmp_path / "out" / "replicas.csv")
    assert [row["commit"] for row in kept] == ["c33954a"] * 10 + ["5b76220 (changed)"] * 5
    for form in ("--table1", "--grid"):
        assert "different commits:\n\n- c33954a: " in report(form, runs=[bbqn, dqn])
    mixed = report(runs=[bbqn, add(GOOD, seed=3)])
    assert mixed.endswith("All have runs of several commits: c33954a; unknown.\n")
