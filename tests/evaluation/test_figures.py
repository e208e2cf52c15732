"""Figures show every seed, their mean, and what belongs to a run."""

import math
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from matplotlib.figure import Figure
from result_folders import run_result

from bbq_torchrl.evaluation.curves import Metrics
from bbq_torchrl.evaluation.figures import draw_comparison, draw_run, moving_average
from bbq_torchrl.evaluation.finished_runs import Replica
from bbq_torchrl.evaluation.groups import Group
from bbq_torchrl.evaluation.run_result import reference_lines
from bbq_torchrl.utils.reports import draw_intervals
from bbq_torchrl.utils.statistics import Estimate


@pytest.fixture
def draw(tmp_path):
    """Draws the curve of a run. Returns the figure that is saved."""

    def drawn(*groups, **given):
        file = tmp_path / "curve.png"
        with patch.object(Figure, "savefig", autospec=True, side_effect=Figure.savefig) as save:
            draw_run(file, groups, title="a run", **given)
        assert file.read_bytes().startswith(b"\x89PNG")
        return save.call_args.args[0]

    return drawn


def group(seeds, rounds=30, label="DQN", **columns):
    columns["success_rate"] = np.random.default_rng(seeds).uniform(size=(rounds, seeds))
    result = run_result(np.linspace(0.4, 0.6, seeds).tolist(), rounds=rounds)
    metrics = Metrics(
        [
            {"round": number, "replica": seed, "dialogues": 50}
            | {name: values[number, seed] for name, values in columns.items()}
            for number in range(rounds)
            for seed in range(seeds)
        ]
    )
    return Group(label, tuple(Replica(Path(), n, {}, result, metrics) for n in range(seeds)))


BESIDE = reference_lines({"rule": 0.2, "repair": 0.7, "random": 0.9}, {"clairvoyant": 0.8})
LINES = [
    "clairvoyant (privileged: it reads what no agent is shown): 0.800",
    "repair (best script measured): 0.700",
]


def labels(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_a_run_is_drawn_with_its_replicas_mean_evaluation_spike_and_extensions(draw):
    run = group(3)
    figure = draw(
        run,
        spiked="spiked with 100 rule dialogues",
        extensions={10: "price", 20: "zip", 40: "state"},
        references=BESIDE,
    )
    (axes,) = figure.axes
    # Three replicas, their mean, three final points, their mean, the spike, two slots in time, the
    # best script, and what knows the goal.
    assert len(axes.get_lines()) == 3 + 1 + 1 + 1 + 1 + 2 + 2
    thick = max(axes.get_lines(), key=lambda line: line.get_linewidth())
    assert thick.get_ydata() == pytest.approx(moving_average(run.success).mean(1))
    assert [text.get_text() for text in axes.texts] == [" price", " zip"]
    assert axes.get_title() == "a run"
    assert labels(figure) == [
        "DQN (3 seeds, mean of 10 rounds)",
        "final evaluation: 0.500",
        "spiked with 100 rule dialogues",
        *LINES,
    ]


def test_evaluations_are_the_main_line_with_training_success_behind_it(draw):
    seeds = 3
    evaluated = np.full((30, seeds), np.nan)
    evaluated[4::5] = np.random.default_rng(1).uniform(size=(6, seeds))
    run = group(seeds, eval_success_rate=evaluated)
    figure = draw(run)

    lines = figure.axes[0].get_lines()
    training, *rest = lines
    main = max(lines, key=lambda line: line.get_linewidth())
    assert training.get_ydata() == pytest.approx(moving_average(run.success).mean(1))
    assert training.get_alpha() < 1
    assert training.get_linewidth() < main.get_linewidth() / 2
    # At the end of the rounds 4, 9, ...: what is evaluated has learned from them.
    assert main.get_xdata().tolist() == [5, 10, 15, 20, 25, 30]
    assert main.get_ydata() == pytest.approx(evaluated[4::5].mean(1))
    # A line for each seed, their mean, the final points, their mean.
    assert len(rest) == seeds + 1 + 2
    assert labels(figure)[:2] == [
        "training, with exploration (mean of 10 rounds)",
        "DQN (3 seeds, evaluated)",
    ]


def test_panels_stand_side_by_side_with_legends_of_their_own_and_the_references():
    common, other = group(5, label="BBQN-MAP"), group(2, label="DQN")
    panels = {"BBQN": [common], "DQN": [common, other]}
    seeds = ["BBQN-MAP (5 seeds, mean of 10 rounds)", "DQN (2 seeds, mean of 10 rounds)"]
    assert labels(draw_comparison({"": [common, other]}, title="both")) == seeds
    figure = draw_comparison(panels, title="both", references=BESIDE)
    assert [axes.get_title() for axes in figure.axes] == ["BBQN", "DQN"]
    # Five seeds and their mean; two others and theirs; the references.
    assert [len(axes.get_lines()) for axes in figure.axes] == [6 + 2, 6 + 3 + 2]
    (band,) = figure.axes[1].collections  # of five seeds, and none of fewer
    mean, points = figure.axes[1].get_lines()[5].get_ydata(), band.get_paths()[0].vertices
    for number in (0, 15, 29):
        ends = points[points[:, 0] == number, 1]
        assert ends.min() < mean[number] < ends.max()
    colors = [axes.get_lines()[5].get_color() for axes in figure.axes]
    assert colors[0] == colors[1] != figure.axes[1].get_lines()[8].get_color()
    shown = [[text.get_text() for text in axes.get_legend().get_texts()] for axes in figure.axes]
    assert shown == [[seeds[0], *LINES], [*seeds, *LINES]]
    assert not figure.legends


def test_intervals_are_drawn_row_by_row_with_gaps_for_missing_values():
    panels = {
        "success": {"DQN": Estimate(0.5, 0.4, 0.7), "BBQN": Estimate(0.6)},
        "rating": {"DQN": Estimate(math.nan)},
    }
    success, rating = draw_intervals(panels, title="both").axes
    assert [label.get_text() for label in success.get_yticklabels()] == ["DQN", "BBQN"]
    ends = [bar.get_segments()[0][:, 0].tolist() for bar in success.collections[:1]]
    assert ends == [[0.4, 0.7]]
    first, *_ = success.get_lines()
    assert (first.get_xdata().tolist(), first.get_ydata().tolist()) == ([0.5], [0])
    assert rating.get_title() == "rating"
