"""Draws docs/figures/deep_sea.png from results/deep_sea.csv.

python examples/deep_sea/figure.py
"""

from __future__ import annotations

import argparse
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING

from deep_sea_results import AGENT_NAMES, RESULTS, Line, read, typical
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "figures" / "deep_sea.png"

# Okabe and Ito's colors, which color-blind readers can distinguish too.
LOOKS = {
    "epsilon_greedy": ("#000000", "s"),
    "bootstrap": ("#E69F00", "v"),
    "bootstrap_prior": ("#009E73", "^"),
    "bbqn_mean": ("#0072B2", "o"),
    "bbqn_independent": ("#56B4E9", "D"),
    "bbqn_shared": ("#D55E00", "P"),
    "gp_mean": ("#F0E442", "<"),
    "gp_draw": ("#8B4513", ">"),
    "epinet": ("#CC79A7", "X"),
    "langevin": ("#999999", "*"),
}
"""Color and marker; variants with zero means have hollow markers and dashed lines."""

PANELS = {
    "The agents": [agent for agent in AGENT_NAMES if not agent.endswith("_zero")],
    "BBQN by its start": [agent for agent in AGENT_NAMES if agent.startswith("bbqn_")],
}


def draw(lines: Sequence[Line], file: Path) -> None:
    """Draws the episodes to solve against N, a marker for each seed.

    Args:
        lines: of the table.
        file: a PNG or SVG file.
    """
    figure = Figure(figsize=(12, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(PANELS), sharex=True, sharey=True)
    for axes, (title, agents) in zip(panels, PANELS.items(), strict=True):
        _draw_agents(axes, lines, agents)
        axes.set_title(title, fontsize=10)
    panels[0].set_ylabel("episodes until solved")
    figure.suptitle("DeepSea: seeds (small) and medians (large); above, how many did not solve")
    # Only once in the legend.
    named = {line.get_label(): line for axes in panels for line in axes.get_lines()}
    handles = [line for label, line in named.items() if not label.startswith("_")]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=130)


def _draw_agents(axes: Axes, lines: Sequence[Line], agents: Sequence[str]) -> None:
    """Draws the seeds and medians of some agents."""
    sizes = sorted({line.size for line in lines})
    unsolved_at = 1.6 * max(line.episodes for line in lines)
    for number, agent in enumerate(agents):
        color, marker = LOOKS[agent.removesuffix("_zero")]
        filled = not agent.endswith("_zero")
        face = color if filled else "white"
        shift = 0.11 * (number - (len(agents) - 1) / 2)
        of_agent = [line for line in lines if line.agent == agent]
        solved = [line for line in of_agent if line.episodes_to_solve is not None]
        axes.plot(
            [line.size + shift for line in solved],
            [line.episodes_to_solve for line in solved],
            marker,
            color=color,
            ms=4.5,
            alpha=0.55,
            mew=0 if filled else 1,
            mfc=face,
        )
        of_size = {n: [line for line in of_agent if line.size == n] for n in sizes}
        # NaN without a median, which interrupts the line.
        medians = [(typical(of_one) if of_one else None) or nan for of_one in of_size.values()]
        axes.plot(
            [n + shift for n in sizes],
            medians,
            marker + ("-" if filled else "--"),
            color=color,
            lw=1.8,
            ms=7,
            mfc=face,
            label=AGENT_NAMES[agent],
        )
        for n, of_one in of_size.items():
            unsolved = sum(line.episodes_to_solve is None for line in of_one)
            if unsolved:
                height = unsolved_at * 1.3**number
                axes.plot([n], [height], marker, color=color, ms=5, mfc=face)
                axes.annotate(
                    f"{unsolved}/{len(of_one)}",
                    (n, height),
                    (5, -3),
                    textcoords="offset points",
                    fontsize=7,
                    color=color,
                )
    bottom, top = 1.0, unsolved_at * 1.3 ** max(map(len, PANELS.values()))
    axes.axhspan(unsolved_at / 1.15, top, color="0.93", zorder=0)
    axes.text(sizes[0] - 0.9, unsolved_at, "not\nsolved", fontsize=8, va="bottom", color="0.3")
    chance = [n for n in range(sizes[0], sizes[-1] + 1) if 2**n < unsolved_at / 1.15]
    axes.plot(chance, [2**n for n in chance], ":", color="0.5", lw=1.2, label="2^N")
    axes.set(
        xlabel="N",
        yscale="log",
        xticks=sizes,
        xlim=(sizes[0] - 1, sizes[-1] + 1),
        ylim=(bottom, top),
    )
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    """Draws the file that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--picture", type=Path, default=PICTURE)
    options = parser.parse_args()
    lines = read(options.results)
    if not lines:
        parser.error(f"{options.results} has no results: python examples/deep_sea/sweep.py")
    draw(lines, options.picture)


if __name__ == "__main__":
    main()
