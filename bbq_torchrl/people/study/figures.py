"""The paper's two figures of its human evaluation: success, and the distribution of ratings."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any

from bbq_torchrl.people.study.database import PRIVATE
from bbq_torchrl.people.study.records import HIGHEST, LOWEST
from bbq_torchrl.people.study.statistics import mean, proportion
from bbq_torchrl.run_folder import write_bytes

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bbq_torchrl.people.study.comparisons import Comparison
    from bbq_torchrl.people.study.results import Results

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
    axes = _axes(results)
    level = 0.0
    for place, agent in enumerate(agents):
        share = proportion(results.successes(agent).values())
        if share.count:
            error = [[share.value - share.low], [share.high - share.value]]
            axes.bar(place, share.value, color=BAR, yerr=error, capsize=4, width=0.6)
            axes.text(place, 0.02, f"n = {share.count}", ha="center", fontsize=8)
            level = max(level, share.high)
    level += 0.04
    for comparison in comparisons:
        if comparison.success.people:
            left, right = agents.index(comparison.better), agents.index(comparison.worse)
            heights = [level, level + 0.02, level + 0.02, level]
            axes.plot([left, left, right, right], heights, color="black", lw=1)
            p = comparison.success.holm
            label = f"p = {p:.3f}" if p >= 0.001 else "p < 0.001"
            axes.text((left + right) / 2, level + 0.025, label, ha="center", fontsize=8)
            level += 0.09
    axes.set(ylabel="success rate", ylim=(0, max(1.0, level + 0.03)))
    _save(axes, file)


def draw_ratings(file: Path, results: Results) -> None:
    """Draws how often each agent got each overall rating, and their mean.

    Args:
        file: a PNG file.
        results: the study's.
    """
    axes = _axes(results)
    for place, agent in enumerate(results.terms.agents):
        people = results.ratings(agent).values()
        values = [value for person in people for value in person]
        bottom = 0.0
        for rating, color in enumerate(RATINGS, start=1):
            share = values.count(rating) / len(values) if values else 0.0
            label = {"label": f"rating {rating}"} if place == 0 else {}
            axes.bar(place, share, bottom=bottom, color=color, width=0.6, **label)
            bottom += share
        if values:
            text = f"mean {mean(people, (LOWEST, HIGHEST)).value:.2f}\nn = {len(values)}"
            axes.text(place, 1.02, text, ha="center", fontsize=8)
    whose = "simulated " if results.simulated else ""
    axes.set(ylabel=f"share of {whose}ratings", ylim=(0, 1.15))
    axes.figure.legend(loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    _save(axes, file)


def _axes(results: Results) -> Any:
    """Returns empty axes with a place for each agent."""
    # The object interface: no window system, and no global state beside other figures.
    from matplotlib.figure import Figure

    agents = list(results.terms.agents)
    width = max(4.0, 1.4 * len(agents) + 1)
    axes = Figure(figsize=(width, 4.5), layout="constrained").add_subplot()
    axes.set_title(results.title)
    axes.set_xticks(range(len(agents)), agents)
    axes.set_yticks([0, 0.2, 0.4, 0.6, 0.8, 1.0])
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _save(axes: Any, file: Path) -> None:
    axes.set_xlim(-0.6, len(axes.get_xticks()) - 0.4)
    picture = BytesIO()
    axes.figure.savefig(picture, dpi=150, format="png")
    write_bytes(file, picture.getvalue(), PRIVATE)
