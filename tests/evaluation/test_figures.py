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

ROUNDS = 30
BESIDE = reference_lines({"rule": 0.2, "repair": 0.7, "random": 0.9}, {"clairvoyant": 0.8})
LINES = [
    "clairvoyant (privileged: it reads what no agent is shown): 0.800",
    "repair (best script measured): 0.700",
]


def group(seeds, label="DQN", every=0):
    """Seeds with random success, some of whose rounds are evaluated."""
    success, evaluated = np.random.default_rng(seeds).uniform(size=(2, ROUNDS, seeds))
    due = [every and (number + 1) % every == 0 for number in range(ROUNDS)]
    rows = [
        {"round": number, "replica": seed, "dialogues": 50, "success_rate": success[number, seed]}
        | ({"eval_success_rate": evaluated[number, seed] if due[number] else math.nan})
        for number in range(ROUNDS)
        for seed in range(seeds)
    ]
    result = run_result(np.linspace(0.4, 0.6, seeds).tolist(), rounds=ROUNDS)
    replicas = (Replica(Path(), n, {}, result, Metrics(rows)) for n in range(seeds))
    return Group(label, tuple(replicas)), evaluated[due]


def labels(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.mark.parametrize("every", [0, 5])
def test_a_run_is_drawn_with_its_replicas_mean_evaluation_spike_and_extensions(tmp_path, every):
    (run, evaluated), file = group(3, every=every), tmp_path / "curve.png"
    with patch.object(Figure, "savefig", autospec=True, side_effect=Figure.savefig) as save:
        draw_run(
            file,
            [run],
            title="a run",
            spiked="spiked with 100 rule dialogues",
            extensions={10: "price", 20: "zip", 40: "state"},
            references=BESIDE,
        )
    figure = save.call_args.args[0]
    assert file.read_bytes().startswith(b"\x89PNG")
    (axes,) = figure.axes
    lines = axes.get_lines()
    # Training behind evaluations; three replicas, their mean, three final points, their mean, the
    # spike, two slots in time, the best script, and what knows the goal.
    assert len(lines) == bool(every) + 3 + 1 + 1 + 1 + 1 + 2 + 2
    main = max(lines, key=lambda line: line.get_linewidth())
    training = moving_average(run.success).mean(1)
    assert main.get_ydata() == pytest.approx(evaluated.mean(1) if every else training)
    assert [text.get_text() for text in axes.texts] == [" price", " zip"]
    assert axes.get_title() == "a run"
    own = ["DQN (3 seeds, mean of 10 rounds)"]
    if every:
        # At the end of the rounds 4, 9, ...: what is evaluated has learned from them.
        assert main.get_xdata().tolist() == [5, 10, 15, 20, 25, 30]
        assert lines[0].get_ydata() == pytest.approx(training)
        assert lines[0].get_linewidth() < main.get_linewidth() / 2
        own = ["training, with exploration (mean of 10 rounds)", "DQN (3 seeds, evaluated)"]
    beside = ["final evaluation: 0.500", "spiked with 100 rule dialogues", *LINES]
    assert labels(figure) == [*own, *beside]


def test_panels_stand_side_by_side_with_legends_of_their_own_and_the_references():
    (common, _), (other, _) = group(5, "BBQN-MAP"), group(2, "DQN")
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
    shown = [[text.get_text() for text in axes.get_legend().get_texts()] for axes in figure.axes]
    assert shown == [[seeds[0], *LINES], [*seeds, *LINES]]


def test_intervals_are_drawn_row_by_row_with_gaps_for_missing_values():
    panels = {
        "success": {"DQN": Estimate(0.5, 0.4, 0.7), "BBQN": Estimate(0.6)},
        "rating": {"DQN": Estimate(math.nan)},
    }
    success, rating = draw_intervals(panels, title="both").axes
    assert [label.get_text() for label in success.get_yticklabels()] == ["DQN", "BBQN"]
    assert success.collections[0].get_segments()[0][:, 0].tolist() == [0.4, 0.7]
    assert rating.get_title() == "rating"
