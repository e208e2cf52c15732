"""Runs are grouped by setting and compared over seeds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from result_folders import make_run, metrics_text
from scipy import stats
from tiny import rows

from bbq_torchrl.evaluation import estimate, estimate_iqm, interquartile_mean
from bbq_torchrl.evaluation.comparison import comparison_report, references, success_table
from bbq_torchrl.evaluation.groups import label, read_groups
from bbq_torchrl.evaluation.report import main
from bbq_torchrl.evaluation.runs import find_results, find_unfinished

GOOD = [0.70, 0.80, 0.75, 0.72, 0.78]
BAD = [0.50, 0.40, 0.60, 0.55, 0.45]


def test_a_privileged_policy_is_drawn_where_all_runs_know_it_and_have_the_same_users(tmp_path):
    known = {"clairvoyant": 0.8}
    first = make_run(tmp_path / "first", [0.5], references=known)
    other = make_run(tmp_path / "other", [0.5], seed=1, references={"clairvoyant": 0.7})
    older = make_run(tmp_path / "older", [0.5], seed=2)
    changes = {"env.slot_error_prob": 0.3}
    harder = make_run(tmp_path / "harder", [0.5], references=known, changes=changes)

    assert references(read_groups([first, other])) == {"clairvoyant": pytest.approx(0.75)}
    assert references(read_groups([first, other, older])) == {}
    assert references(read_groups([first, harder])) == {}


def test_results_are_found_in_and_below_folders_once(tmp_path):
    first = make_run(tmp_path / "sweep" / "0", [0.5])
    second = make_run(tmp_path / "sweep" / "deeper" / "1", [0.5], seed=1)
    found = find_results([tmp_path / "sweep", first])
    assert found == [first.resolve(), second.resolve()]


def test_results_are_found_in_the_order_of_their_numbers(tmp_path):
    folders = [make_run(tmp_path / name, [0.5]) for name in ("2_dqn", "5²", "10_bbqn")]
    assert find_results([tmp_path]) == [folder.resolve() for folder in folders]


def test_runs_without_a_result_are_named_wherever_they_stand(tmp_path):
    finished = make_run(tmp_path / "runs" / "1", [0.5])
    stopped, failed, waiting = (
        make_run(tmp_path / "runs" / name, [0.5], seed=1) for name in ("2", "3", "10")
    )
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


def test_runs_that_differ_in_their_seed_alone_are_one_group(tmp_path):
    folders = [
        make_run(tmp_path / "0", [0.5, 0.6], seed=0),
        make_run(tmp_path / "other", [0.1], agent="dqn", explore="epsilon_greedy"),
        make_run(tmp_path / "1", [0.7], seed=1),
    ]
    bbqn, dqn = read_groups(folders)
    assert (bbqn.label, dqn.label) == ("BBQN-MAP", "DQN")
    assert bbqn.final == [0.5, 0.6, 0.7]
    assert bbqn.cumulative == pytest.approx([0.25, 0.3, 0.35])
    assert bbqn.success.tolist() == [[0.25, 0.3, 0.35]] * 3
    assert (bbqn.reward, bbqn.turns) == (10, 8)
    assert dqn.final == [0.1]


@pytest.mark.parametrize(
    ("other", "labels"),
    [
        ({"prior_std": 0.05}, ("BBQN-MAP, agent.prior_std=0.1", "BBQN-MAP, agent.prior_std=0.05")),
        ({"target": "mc"}, ("BBQN-MAP", "BBQN-MC")),
        ({"rounds": 2}, ("BBQN-MAP, protocol.rounds=3", "BBQN-MAP, protocol.rounds=2")),
        (
            {"explore": "epsilon_greedy"},
            ("BBQN-MAP, explore=thompson", "BBQN-MAP, explore=epsilon_greedy"),
        ),
    ],
)
def test_a_label_says_what_tells_groups_of_an_agent_apart(tmp_path, other, labels):
    folders = [make_run(tmp_path / "a", [0.5]), make_run(tmp_path / "b", [0.5], **other)]
    assert tuple(group.label for group in read_groups(folders)) == labels


def test_a_label_has_the_keys_that_tell_settings_of_one_option_apart(tmp_path, capsys):
    make_run(tmp_path / "0", [0.5])
    make_run(tmp_path / "1", [0.6], changes={"explore.per": "round"})
    make_run(tmp_path / "2", [0.4], explore="greedy", changes={"explore.per": "episode"})
    make_run(tmp_path / "3", [0.4], agent="dqn", explore="greedy")
    groups = read_groups([tmp_path / str(number) for number in range(4)])
    assert [group.label for group in groups] == [
        "BBQN-MAP, explore=thompson, explore.per=step",
        "BBQN-MAP, explore=thompson, explore.per=round",
        "BBQN-MAP, explore=greedy",
        "DQN",
    ]
    assert main([str(tmp_path)]) == 0
    one, other, *_ = (group.label for group in groups)
    assert f"| {one} minus {other} | 1 |" in capsys.readouterr().out


def settings_of(group, *keys):
    """A group's keys and values: the name of its option, and keys that a version may lack."""
    values = {f"{group}.{key}": st.sampled_from([None, 0.1, 2, "step"]) for key in keys}
    named = st.fixed_dictionaries({f"{group}.name": st.sampled_from("ab")}, optional=values)
    return named | st.just({})


SETTINGS = st.tuples(
    settings_of("agent", "lr", "net.name"),
    settings_of("explore", "per", "shared"),
    settings_of("env", "start"),
    settings_of("protocol", "rounds"),
).map(lambda groups: {key: value for group in groups for key, value in group.items()})
NAMED = st.tuples(st.sampled_from(["DQN", "BBQN-MAP"]), SETTINGS)


@given(
    st.lists(
        NAMED, min_size=1, max_size=6, unique_by=lambda one: (one[0], frozenset(one[1].items()))
    )
)
def test_labels_of_different_settings_differ(settings):
    labels = [label(name, setting, settings) for name, setting in settings]
    assert len({*labels}) == len(labels)


def test_replicas_with_values_of_their_own_are_groups_of_their_own(tmp_path):
    values = [{"agent.prior_std": std} for std in (0.05, 0.05, 0.2)]
    folders = [
        make_run(tmp_path / "all", [0.5, 0.6, 0.9], values=values, prior_std=[0.05, 0.05, 0.2]),
        make_run(tmp_path / "one", [0.7], seed=1, prior_std=0.2),
    ]
    small, large = read_groups(folders)
    assert small.label == "BBQN-MAP, agent.prior_std=0.05"
    assert large.label == "BBQN-MAP, agent.prior_std=0.2"
    assert (small.final, large.final) == ([0.5, 0.6], [0.9, 0.7])
    assert small.success.tolist() == [[0.25, 0.3]] * 3
    assert large.success.tolist() == [[0.45, 0.35]] * 3


@pytest.mark.parametrize("is_of_a_list", [False, True])
def test_one_training_does_not_count_as_two_seeds(tmp_path, is_of_a_list):
    one = make_run(tmp_path / "one", [0.7], seed=4, prior_std=0.2)
    stds = [0.05, 0.2] if is_of_a_list else [0.2, 0.2]
    values = [{"agent.prior_std": std} for std in stds]
    other = make_run(tmp_path / "other", [0.5, 0.6], seed=4, values=values, prior_std=stds)
    with pytest.raises(ValueError, match=r"same setting and seed \(4\)"):
        read_groups([one, other])


def test_metrics_and_result_must_be_of_one_run(tmp_path):
    run, other = make_run(tmp_path / "a", [0.5]), make_run(tmp_path / "b", [0.5], rounds=2)
    (other / "metrics.csv").replace(run / "metrics.csv")
    with pytest.raises(ValueError, match="metrics are of 2 rounds and 1 replicas, the result of 3"):
        read_groups([run])


MANY = "agent: {name: dqn}\nexplore: {name: greedy}\nreplicas: many\n"


@pytest.mark.parametrize("text", [None, "- 1\n", "seed: 1\n", MANY])
def test_a_configuration_that_is_none_is_refused(tmp_path, text):
    file = make_run(tmp_path / "run", [0.5]) / "config.yaml"
    if text is None:
        file.unlink()
    else:
        file.write_text(text)
    with pytest.raises(ValueError, match=r"config\.yaml (cannot be read|is not the configuration)"):
        read_groups([tmp_path / "run"])


def test_a_table_has_the_statistics_of_each_group_and_its_csv_all_digits(tmp_path):
    runs = [
        make_run(tmp_path / "bbqn", GOOD),
        make_run(tmp_path / "dqn", BAD[:3], agent="dqn"),
        make_run(tmp_path / "noisy", BAD[:1], agent="dqn", noisy=True),
    ]
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


PAIR = ({}, {"agent": "dqn", "explore": "epsilon_greedy"})
FORMS = {
    "report": (PAIR, {"report", "pairs", "learning"}, {"curves"}),
    "table1": (
        PAIR,
        {f"table1_{env}{end}" for env in ("full", "domain_ext") for end in ("", "_pairs")},
        {"table1_full"},
    ),
    "grid": (
        ({}, {"explore": "greedy"}),
        {"grid_final", "grid_final_by_learner", "grid_cumulative", "grid_cumulative_by_learner"},
        {"grid"},
    ),
    "ablations": (({}, {"prior_std": 0.3}), {"ablations_agent.prior_std"}, {"ablations"}),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_report_is_written_as_markdown_csv_png_and_svg(tmp_path, capsys, form):
    settings, tables, figures = FORMS[form]
    for number, setting in enumerate(settings):
        make_run(tmp_path / "runs" / str(number), GOOD, **setting)
    out = tmp_path / "report"
    option = [] if form == "report" else [f"--{form}"]
    assert main([str(tmp_path / "runs"), *option, "--out", str(out)]) == 0
    text = (out / f"{form}.md").read_text()
    assert text.startswith(capsys.readouterr().out)
    assert all(f"]({name}.png)" in text for name in figures)
    assert {file.stem for file in out.glob("*.csv")} == {*tables, "replicas"}
    assert len(rows(out / "replicas.csv")) == 10
    for kind, start in (("png", b"\x89PNG"), ("svg", b"<?xml")):
        pictures = {file.stem: file.read_bytes() for file in out.glob(f"*.{kind}")}
        assert pictures.keys() == figures
        assert all(picture.startswith(start) for picture in pictures.values())


def test_one_setting_has_no_pairs_and_none_of_an_earlier_report_stay(tmp_path, capsys):
    run, out = make_run(tmp_path / "run", GOOD), tmp_path / "report"
    out.mkdir()
    (out / "pairs.csv").write_text("of another report")
    assert main([str(run), "--out", str(out)]) == 0
    assert "pairs" not in capsys.readouterr().out
    assert not (out / "pairs.csv").exists()


def test_a_figure_holds_seven_groups_and_the_next_one_the_rest(tmp_path):
    runs = [make_run(tmp_path / str(n), [0.5], lr=0.1 * (n + 1)) for n in range(8)]
    assert list(comparison_report(read_groups(runs)).figures) == ["curves", "curves_2"]


def test_a_run_that_is_not_finished_is_named(tmp_path, capsys):
    make_run(tmp_path / "done", GOOD)
    (make_run(tmp_path / "killed", GOOD, seed=1) / "result.json").unlink()
    assert main([str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert f"\n\nLeft out, since not finished: {tmp_path / 'killed'}.\n\n| agent |" in text
    assert "| BBQN-MAP | thompson | 5 |" in text


def test_a_run_that_goes_on_to_more_rounds_is_named_and_breaks_no_report(tmp_path, capsys):
    make_run(tmp_path / "done", GOOD)
    make_run(tmp_path / "extended", GOOD, seed=1, changes={"protocol.rounds": 5})
    # The training is on its way: metrics of a round more than the result is of.
    (tmp_path / "extended" / "metrics.csv").write_text(metrics_text(GOOD, rounds=4))
    assert main([str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert f"Left out, since not finished: {tmp_path / 'extended'}." in text
    assert "| BBQN-MAP | thompson | 5 |" in text
