"""Figures: the learning curve of a run, and comparisons with bands over seeds."""

from __future__ import annotations

import math
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from bbq_torchrl.utils.reports import COLORS, add_legend, save, subplots
from bbq_torchrl.utils.statistics import estimate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from bbq_torchrl.evaluation.groups import Group

MIN_BAND = 5
"""Minimum number of seeds for a band: with fewer it would hide the curves."""

WINDOW = 10
"""Rounds averaged in the thick curves: 500 dialogues have a standard error of .02."""

DASHES = ("-", "--", ":")


def moving_average(values: Any, window: int = WINDOW) -> Any:
    """Returns the mean of the last ``window`` rounds (fewer at the start) along the first axis.

    Examples:
        >>> moving_average(np.array([0.0, 1.0, 2.0]), window=2).tolist()
        [0.0, 0.5, 1.5]
    """
    values = np.asarray(values, dtype=float)
    total = np.cumsum(values, axis=0)
    total[window:] = total[window:] - total[:-window]
    counts = np.minimum(np.arange(1, len(values) + 1), window)
    return total / counts.reshape(-1, *[1] * (values.ndim - 1))


def draw_run(
    file: Path,
    groups: Sequence[Group],
    *,
    title: str,
    spiked: str | None = None,
    extensions: Mapping[int, str] | None = None,
    references: Mapping[str, float] | None = None,
) -> None:
    """Draws the learning curve of one run into a PNG file.

    The main line is the success of evaluations during training, with training success lighter
    behind it; without such evaluations it is training success. Several groups have one entry each
    in the legend, with the final evaluation.

    Args:
        file: the file.
        groups: the run's replicas, in several groups if their settings differ.
        title: the heading.
        spiked: label of the spike, drawn at round 0; ``None`` without a spike.
        extensions: round -> slot that the domain gained.
        references: label -> success rate to compare with.
    """
    figure, (axes,) = subplots(1)
    end = groups[0].first.rounds
    for group, color in zip(groups, _colors(len(groups)), strict=True):
        mean = float(np.mean(group.final))
        # The final evaluation of a single group has its own color.
        if len(groups) > 1:
            final, ending, label = color, f", final {mean:.3f}", ""
        else:
            final, ending, label = COLORS[1], "", f"final evaluation: {mean:.3f}"
        if group.evaluation is None:
            _draw_training(axes, group, color, ending=ending)
        else:
            training = moving_average(group.success).mean(1)
            is_first = group is groups[0]
            explored = f"training, with exploration (mean of {WINDOW} rounds)" if is_first else ""
            axes.plot(training, color=color, lw=1, alpha=0.4, label=explored)
            evaluated = f"{group.label} ({_seeds(group)}, evaluated){ending}"
            (rounds,) = np.isfinite(group.evaluation[:, 0]).nonzero()
            # The evaluated agent has learned from the round, so it is drawn at the round's end.
            rates = group.evaluation[rounds]
            _draw_seeds(axes, rounds + 1, rates, color, "o-", label=evaluated)
        axes.plot([end] * len(group.final), group.final, "o", ms=5, color=final)
        axes.axhline(mean, color=final, lw=1, ls="--", label=label)
    if spiked is not None:
        axes.plot([0], [0], "^", color=COLORS[2], ms=8, clip_on=False, label=spiked, zorder=5)
    for start, slot in (extensions or {}).items():
        if start < end:
            axes.axvline(start, color="0.6", lw=0.8, ls=":")
            axes.text(start, 1.0, f" {slot}", rotation=90, va="top", ha="left", fontsize=7)
    _draw_references(axes, references or {})
    axes.set(xlabel="round", ylabel="success rate", xlim=(0, None), ylim=(0, 1), title=title)
    add_legend(figure)
    save(figure, file)


def draw_comparison(
    panels: Mapping[str, Sequence[Group]],
    *,
    title: str,
    references: Mapping[str, float] | None = None,
) -> Figure:
    """Draws groups of seeds: every seed's training success, the mean, and its 95 % band.

    The band is the t interval of the mean over seeds (five or more), round by round.

    Args:
        panels: heading of a panel -> its groups. A group may be in several.
        title: the heading of the figure.
        references: label -> success rate to compare with.
    """
    figure, axes = subplots(len(panels))
    for panel, (heading, groups) in zip(axes, panels.items(), strict=True):
        for group, color in zip(groups, _colors(len(groups)), strict=True):
            _draw_training(panel, group, color, band=True)
        _draw_references(panel, references or {})
        panel.set(xlabel="round", ylabel="success rate", xlim=(0, None), ylim=(0, 1), title=heading)
        if len(panels) > 1:  # colors are of other groups in each panel
            style = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2)}
            panel.legend(fontsize=7, frameon=False, **style)
    figure.suptitle(title)
    if len(panels) == 1:
        add_legend(figure)
    return figure


def draw_bands(panels: Mapping[str, Mapping[str, Any]], *, title: str, xlabel: str) -> Figure:
    """Draws a panel of curves with bands for each mapping.

    Args:
        panels: heading -> label -> places, values, lower and upper ends, shape [4, points]; NaN
            ends leave out the band.
        title: the heading.
        xlabel: label of the places.
    """
    figure, axes = subplots(len(panels))
    labels = list(dict.fromkeys(label for curves in panels.values() for label in curves))
    # More curves than colors: the next ones are dashed.
    styles = dict(zip(labels, cycle((color, dash) for dash in DASHES for color in COLORS)))
    for panel, (heading, curves) in zip(axes, panels.items(), strict=True):
        for label, (places, values, low, high) in curves.items():
            color, dash = styles[label]
            name = label if label in labels else None  # each is in the legend once
            panel.plot(places, values, dash, color=color, lw=1.8, label=name)
            panel.fill_between(places, low, high, color=color, alpha=0.12, lw=0)
            labels = [other for other in labels if other != label]
        panel.set(title=heading, xlabel=xlabel, ylim=(0, 1))
    figure.suptitle(title)
    add_legend(figure)
    return figure


def _colors(count: int) -> Sequence[Any]:
    """Returns colors of groups; for many groups a color scale."""
    if count <= len(COLORS):
        return COLORS[:count]
    from matplotlib import colormaps

    return [colormaps["viridis"](place) for place in np.linspace(0, 0.95, count)]


def _seeds(group: Group) -> str:
    return "1 seed" if len(group.final) == 1 else f"{len(group.final)} seeds"


def _draw_training(
    axes: Any, group: Group, color: str, *, band: bool = False, ending: str = ""
) -> None:
    success, smooth = group.success, moving_average(group.success)
    # A single seed shows its raw rounds; several would hide one another.
    thin = success if success.shape[1] == 1 else smooth
    label = f"{group.label} ({_seeds(group)}, mean of {WINDOW} rounds){ending}"
    rounds = np.arange(len(success))
    _draw_seeds(axes, rounds, smooth, color, "-", band=band, thin=thin, label=label)


def _draw_seeds(
    axes: Any,
    rounds: Any,
    values: Any,
    color: str,
    line: str,
    *,
    label: str,
    band: bool = False,
    thin: Any = None,
) -> None:
    """Draws values [rounds, seeds]: each seed (``thin`` if given), the mean, and its interval."""
    axes.plot(rounds, values if thin is None else thin, color=color, lw=0.7, alpha=0.35)
    axes.plot(rounds, values.mean(1), line, color=color, lw=2.2, ms=3, label=label)
    if band and values.shape[1] >= MIN_BAND:
        # Also for rewards, so without bounds; the axes clip what exceeds those of a rate.
        found = [estimate(row, bounds=(-math.inf, math.inf)) for row in values]
        low, high = [item.low for item in found], [item.high for item in found]
        axes.fill_between(rounds, low, high, color=color, alpha=0.15, lw=0)


def _draw_references(axes: Any, references: Mapping[str, float]) -> None:
    for (name, rate), line in zip(references.items(), cycle((":", "-."))):
        axes.axhline(rate, color="0.35", lw=1, ls=line, label=f"{name}: {rate:.3f}")
