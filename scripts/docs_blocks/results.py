"""Tables and figures of trained agents, from the result folders in results/.

``results/<experiment>/<run>/`` is what ``scripts/keep_result.py`` keeps of a run folder.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.evaluation import (
    estimate,
    interquartile_mean,
    probability_of_improvement,
    read_metrics,
    read_result,
)
from bbq_torchrl.evaluation.figures import Curves, draw_comparison
from scripts.docs_blocks.markdown import table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["EXPERIMENTS", "Run", "draw_figures", "results_blocks", "runs"]

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results"
FIGURES = ROOT / "docs" / "figures"

EXPERIMENTS = {
    "learning_movie": "Full domain, our corpus",
    "learning_miulab": "Full domain, the public MiuLab corpus",
    "extension_movie": "Domain extension, our corpus",
    "no_spike_movie": "Without spiking, our corpus",
    "no_spike_miulab": "Without spiking, the public MiuLab corpus",
}
"""Folder in results/ -> what was trained on."""

IN_README = ("learning_miulab", "learning_movie", "extension_movie")


@dataclass(frozen=True)
class Run:
    """What was kept of a run.

    Args:
        folder: its result folder.
    """

    folder: Path

    @cached_property
    def config(self) -> Any:
        """The composed configuration, as plain mappings."""
        return yaml.safe_load((self.folder / "config.yaml").read_text(encoding="utf-8"))

    @cached_property
    def overrides(self) -> list[str]:
        """What the command line said."""
        return yaml.safe_load((self.folder / "overrides.yaml").read_text(encoding="utf-8"))

    @property
    def command(self) -> str:
        """The command that made it."""
        return " ".join(["python train.py", *self.overrides])

    @property
    def label(self) -> str:
        """The agent as the paper calls it, and how it explores where that is not its usual way."""
        agent = self.config["agent"]
        name = f"BBQN-{agent['target'].upper()}" if agent["name"] == "bbqn" else "DQN"
        explore = self.config["explore"]["name"]
        usual = {"bbqn": "thompson", "dqn": "epsilon_greedy"}[agent["name"]]
        return name if explore == usual else f"{name}, {explore}"

    @cached_property
    def final(self) -> list[float]:
        """Success of the final evaluation, one value for each seed."""
        return [entry.success_rate for entry in read_result(self.folder).per_replica]

    @cached_property
    def cumulative(self) -> list[float]:
        """Share of successful training dialogues, one value for each seed."""
        return [float(value) for value in read_metrics(self.folder).training_success]


def runs(experiment: str) -> list[Run]:
    """Returns what is kept of an experiment, in order of the folders' names."""
    return [Run(file.parent) for file in sorted((RESULTS / experiment).glob("*/result.json"))]


def results_blocks() -> dict[str, Callable[[], str]]:
    """Returns a block for every experiment, and the one of the README."""
    blocks: dict[str, Callable[[], str]] = {"results.readme": _readme}
    return blocks | {f"results.{name}": partial(_experiment, name) for name in EXPERIMENTS}


def draw_figures() -> list[Path]:
    """Draws the learning curves of every experiment; returns the files."""
    FIGURES.mkdir(exist_ok=True)
    drawn = []
    for experiment, title in EXPERIMENTS.items():
        if kept := runs(experiment):
            drawn.append(FIGURES / f"{experiment}.png")
            draw_comparison(drawn[-1], [_curves(run) for run in kept], title=title)
    return drawn


def _curves(run: Run) -> Curves:
    return Curves(run.label, read_metrics(run.folder)["success_rate"], run.final)


def _experiment(experiment: str) -> str:
    """Returns table, comparison, figure and commands of one experiment."""
    kept = runs(experiment)
    if not kept:
        return "Not measured yet."
    rows = []
    for run in kept:
        result = read_result(run.folder)
        rows.append(
            (
                run.label,
                result.replicas,
                result.rounds,
                estimate(run.final),
                f"{interquartile_mean(run.final):.3f}",
                f"{result.reward:.2f}",
                f"{result.turns:.2f}",
                estimate(run.cumulative),
            )
        )
    head = (
        "agent",
        "seeds",
        "rounds",
        "final success",
        "IQM",
        "reward",
        "turns",
        "cumulative training success",
    )
    parts = [table(head, rows, numbers=len(head) - 1), *_comparison(kept)]
    parts.append(f"![Training success by round](figures/{experiment}.png)")
    parts.append("```bash\n" + "\n".join(run.command for run in kept) + "\n```")
    return "\n\n".join(parts)


def _comparison(kept: list[Run]) -> list[str]:
    """Returns the first agent beside each of the others, in a sentence each."""
    first, *others = kept
    return [
        f"Probability that a seed of {first.label} does better than one of {other.label}: "
        f"{probability_of_improvement(first.final, other.final)} by final success, "
        f"{probability_of_improvement(first.cumulative, other.cumulative)} by cumulative success."
        for other in others
    ]


def _readme() -> str:
    """Returns the main results in a table, and a figure."""
    rows = [
        (title, run.label, len(run.final), estimate(run.final), estimate(run.cumulative))
        for experiment, title in EXPERIMENTS.items()
        if experiment in IN_README
        for run in runs(experiment)
    ]
    if not rows:
        return "Not measured yet."
    shown = next(name for name in IN_README if runs(name))
    head = ("trained on", "agent", "seeds", "final success", "cumulative training success")
    return (
        f"{table(head, rows, numbers=3)}\n\n"
        "(Mean over seeds with its 95 % interval. Final success: 10,000 dialogues of each seed, "
        "BBQN by the network at the mean weights.)\n\n"
        f"![{EXPERIMENTS[shown]}: training success by round](docs/figures/{shown}.png)"
    )
