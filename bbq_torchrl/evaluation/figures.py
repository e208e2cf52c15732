"""Figures: the learning curve of a run, and comparisons with bands over seeds."""

from __future__ import annotations

import math
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from bbq_torchrl.utils.reports import save
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

LEGEND_HEIGHT = 1.0
"""Inches of a figure's height for the legend; a higher legend makes the figure grow."""

# Okabe and Ito's palette, also for color-blind readers.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
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
    figure, axes = _axes()
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
            _draw_evaluated(axes, group.evaluation, color, "o-", label=evaluated)
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
    save(_finished(figure, [axes]), file)


def draw_comparison(
    groups: Sequence[Group], *, title: str, references: Mapping[str, float] | None = None
) -> Figure:
    """Draws groups of seeds: every seed's training success, the mean, and its 95 % band.

    The band is the t interval of the mean over seeds (five or more), round by round.

    Args:
        groups: one for each setting.
        title: the heading.
        references: label -> success rate to compare with.
    """
    figure, axes = _axes()
    for group, color in zip(groups, _colors(len(groups)), strict=True):
        _draw_training(axes, group, color, band=True)
    _draw_references(axes, references or {})
    axes.set(xlabel="round", ylabel="success rate", xlim=(0, None), ylim=(0, 1), title=title)
    return _finished(figure, [axes])


def draw_families(
    families: Mapping[str, Sequence[Group]],
    *,
    title: str,
    references: Mapping[str, float] | None = None,
) -> Figure:
    """Draws a column for each family of groups, as :func:`draw_comparison` draws groups.

    The rows are training success, success of evaluations during training, and training reward, if
    any group has them.

    Args:
        families: heading of a column -> its groups. A group may be in several.
        title: the heading.
        references: label -> success rate to compare with.
    """
    groups = [group for family in families.values() for group in family]
    names = {"success": "training success"}
    if any(group.evaluation is not None for group in groups):
        names["evaluation"] = "success in evaluation"
    if any(group.curves("reward") is not None for group in groups):
        names["reward"] = "training reward"
    figure, axes = _axes(rows=len(names), columns=len(families), shared=True)
    grid = np.reshape(axes, (len(names), len(families)))
    for (heading, family), column in zip(families.items(), grid.T, strict=True):
        drawn = dict(zip(names, column, strict=True))
        for group, color in zip(family, _colors(len(family)), strict=True):
            _draw_training(drawn["success"], group, color, band=True)
            if "evaluation" in drawn and group.evaluation is not None:
                _draw_evaluated(drawn["evaluation"], group.evaluation, color, "-", band=True)
            if "reward" in drawn and (rewards := group.curves("reward")) is not None:
                reward = moving_average(rewards)
                _draw_seeds(drawn["reward"], np.arange(len(reward)), reward, color, "-", band=True)
        for name, axes in drawn.items():
            if name != "reward":
                _draw_references(axes, references or {})
                axes.set(ylim=(0, 1))
            axes.margins(x=0)
        drawn["success"].set(title=heading)
        axes.set(xlabel="round")
        handles, labels = drawn["success"].get_legend_handles_labels()
        style = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2)}
        axes.legend(handles, labels, fontsize=7, frameon=False, **style)
    for name, axes in zip(names, grid[:, 0], strict=True):
        axes.set(ylabel=names[name])
    figure.suptitle(title)
    return _finished(figure, list(grid.flat), legend=False)


def draw_panels(
    panels: Mapping[str, Mapping[str, Group]], *, title: str, marked: Group | None = None
) -> Figure:
    """Draws rows of groups: every seed of each group, their mean and its 95 % t interval.

    Args:
        panels: label of a panel -> label of a group -> the group.
        title: the heading.
        marked: the group marked by a star.
    """
    figure, axes = _panels(len(panels), 2)
    styles = (
        ("final", "final success", -0.1, COLORS[0], "o"),
        ("cumulative", "cumulative training success", 0.1, COLORS[1], "s"),
    )
    for panel, (key, row) in zip(axes, panels.items(), strict=True):
        for number, group in enumerate(row.values()):
            for quantity, label, aside, color, marker in styles:
                seeds, place = getattr(group, quantity), number + aside
                panel.plot([place] * len(seeds), seeds, ".", color=color, alpha=0.35)
                found = estimate(seeds)
                style = {"fmt": marker, "color": color, "capsize": 3, "ms": 5}
                style["label"] = label if number == 0 and panel is axes[0] else None
                ends = [[found.value - found.low], [found.high - found.value]]
                panel.errorbar(place, found.value, ends, **style)
        names = [f"{value}*" if group is marked else value for value, group in row.items()]
        names = [name.replace("_", "\n") for name in names]  # breaks long labels
        panel.set(xlabel=key, xticks=range(len(names)), xticklabels=names, ylim=(0, 1))
        panel.set_xlim(-0.5, len(names) - 0.5)
        panel.tick_params(axis="x", labelsize="small")
    figure.suptitle(title)
    return _finished(figure, axes)


def draw_bands(panels: Mapping[str, Mapping[str, Any]], *, title: str, xlabel: str) -> Figure:
    """Draws a panel of curves with bands for each mapping.

    Args:
        panels: heading -> label -> places, values, lower and upper ends, shape [4, points]; NaN
            ends leave out the band.
        title: the heading.
        xlabel: label of the places.
    """
    figure, axes = _panels(len(panels), 3)
    labels = list(dict.fromkeys(label for curves in panels.values() for label in curves))
    # More curves than colors: the next ones are dashed.
    styles = dict(zip(labels, cycle((color, dash) for dash in DASHES for color in COLORS)))
    for panel, (heading, curves) in zip(axes, panels.items(), strict=True):
        for label, (places, values, low, high) in curves.items():
            (color, dash), name = styles[label], label if label in labels else None
            panel.plot(places, values, dash, color=color, lw=1.8, label=name)
            panel.fill_between(places, low, high, color=color, alpha=0.12, lw=0)
            labels = [other for other in labels if other != label]  # each is in the legend once
        panel.set(title=heading, xlabel=xlabel, ylim=(0, 1))
    figure.suptitle(title)
    return _finished(figure, axes)


def _colors(count: int) -> Sequence[Any]:
    """Returns colors of groups; for many groups a color scale."""
    if count <= len(COLORS):
        return COLORS[:count]
    from matplotlib import colormaps

    return [colormaps["viridis"](place) for place in np.linspace(0, 0.95, count)]


def _axes(rows: int = 1, columns: int = 1, *, shared: bool = False) -> tuple[Figure, Any]:
    # The object interface needs no window system and has no global state.
    from matplotlib.figure import Figure

    size = (max(8, 4 * columns), 4.5 if rows == 1 else 3.3 * rows)
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, sharex=shared, sharey="row" if shared else False)


def _panels(count: int, most: int) -> tuple[Figure, list[Any]]:
    """Returns a figure of so many panels, at most ``most`` in a row."""
    columns = min(most, count)
    figure, grid = _axes(rows=-(-count // columns), columns=columns)
    axes = list(np.atleast_1d(grid).flat)
    for panel in axes[count:]:
        panel.remove()
    return figure, axes[:count]


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


def _draw_evaluated(
    axes: Any, rates: Any, color: Any, line: str, *, band: bool = False, label: str | None = None
) -> None:
    (rounds,) = np.isfinite(rates[:, 0]).nonzero()
    # The evaluated agent has learned from the round, so it is drawn at the round's end.
    _draw_seeds(axes, rounds + 1, rates[rounds], color, line, band=band, label=label)


def _draw_seeds(
    axes: Any,
    rounds: Any,
    values: Any,
    color: str,
    line: str,
    *,
    band: bool,
    thin: Any = None,
    label: str | None = None,
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


def _finished(figure: Figure, panels: Sequence[Any], *, legend: bool = True) -> Figure:
    for axes in panels:
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    if legend:
        _add_legend(figure)
    return figure


def _add_legend(figure: Figure) -> None:
    """Adds the legend below the axes, in two columns, or one if they are too wide.

    A figure that is too small for it grows.
    """
    for columns in (2, 1):
        legend = figure.legend(loc="outside lower center", ncols=columns, fontsize=8, frameon=False)
        box = legend.get_window_extent()
        width, height = box.width / figure.dpi, box.height / figure.dpi
        if width <= figure.get_figwidth() or columns == 1:
            break
        legend.remove()
    figure.set_figwidth(max(figure.get_figwidth(), width))
    figure.set_figheight(figure.get_figheight() + max(0.0, height - LEGEND_HEIGHT))
