"""The paper's two figures of its human evaluation: success, and the distribution of ratings."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from bbq_torchrl.study.statistics import mean, proportion

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bbq_torchrl.study.comparisons import Comparison
    from bbq_torchrl.study.results import Results

__all__ = ["draw_ratings", "draw_success"]

BAR = "#56B4E9"
RATINGS = ("#D55E00", "#E6A277", "#DDDDDD", "#7FB3D5", "#0072B2")  # from 1 to 5


def draw_success(file: Path, results: Results, comparisons: Sequence[Comparison]) -> None:
    """Draws each agent's success with its interval and number of sessions, and p of each pair.

    Args:
        file: a PNG file.
        results: the study's.
        comparisons: of the declared pairs; Holm's p is shown.
    """
    agents = list(results.terms.agents)
    figure, axes = _axes(len(agents))
    tops = {}
    for place, agent in enumerate(agents):
        people = [[item.success for item in sessions] for sessions in results.of(agent).values()]
        share = proportion(people)
        if share.count:
            error = [[share.value - share.low], [share.high - share.value]]
            axes.bar(place, share.value, color=BAR, yerr=error, capsize=4, width=0.6)
            axes.text(place, 0.02, f"n = {share.count}", ha="center", fontsize=8)
        tops[agent] = share.high if share.count else 0.0
    level = max(tops.values()) + 0.04
    for comparison in comparisons:
        if comparison.people:
            left, right = agents.index(comparison.better), agents.index(comparison.worse)
            heights = [level, level + 0.02, level + 0.02, level]
            axes.plot([left, left, right, right], heights, color="black", lw=1)
            label = f"p = {comparison.holm:.3f}" if comparison.holm >= 0.001 else "p < 0.001"
            axes.text((left + right) / 2, level + 0.025, label, ha="center", fontsize=8)
            level += 0.09
    axes.set(ylabel="success rate", ylim=(0, max(1.0, level + 0.03)), title=_title(results))
    axes.set_yticks([0, 0.2, 0.4, 0.6, 0.8, 1.0])
    _save(figure, axes, file, agents)


def draw_ratings(file: Path, results: Results) -> None:
    """Draws how often each agent got each overall rating, and their mean.

    Args:
        file: a PNG file.
        results: the study's.
    """
    agents = list(results.terms.agents)
    figure, axes = _axes(len(agents))
    for place, agent in enumerate(agents):
        people = [
            [float(item.ratings["overall"]) for item in sessions if item.ratings]
            for sessions in results.of(agent).values()
        ]
        values = [value for person in people for value in person]
        bottom = 0.0
        for rating, color in enumerate(RATINGS, start=1):
            share = values.count(rating) / len(values) if values else 0.0
            label = {"label": f"rating {rating}"} if place == 0 else {}
            axes.bar(place, share, bottom=bottom, color=color, width=0.6, **label)
            bottom += share
        if values:
            text = f"mean {mean(people).value:.2f}\nn = {len(values)}"
            axes.text(place, 1.02, text, ha="center", fontsize=8)
    axes.set(
        ylabel=f"share of {'simulated ' if results.simulated else ''}ratings",
        ylim=(0, 1.15),
        title=_title(results),
    )
    axes.set_yticks([0, 0.2, 0.4, 0.6, 0.8, 1.0])
    figure.legend(loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    _save(figure, axes, file, agents)


def _title(results: Results) -> str:
    name = results.terms.name
    return f"{name} (simulated users)" if results.simulated else name


def _axes(count: int) -> tuple[Any, Any]:
    # The object interface: no window system, and no global state beside other figures.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(max(4.0, 1.4 * count + 1), 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def _save(figure: Any, axes: Any, file: Path, agents: Sequence[str]) -> None:
    axes.set_xticks(range(len(agents)), agents)
    axes.set_xlim(-0.6, len(agents) - 0.4)
    axes.spines[["top", "right"]].set_visible(False)
    temporary = file.with_name(f".{file.name}.new")
    figure.savefig(temporary, dpi=150, format="png")
    os.replace(temporary, file)
