"""The tables of docs/learning_starts.md: the plateau, the searches, and what was tried."""

from __future__ import annotations

import math
from collections import defaultdict
from statistics import fmean, median

from bbq_torchrl.evaluation.learning import rounds_to_reach
from bbq_torchrl.evaluation.pairs import pair
from bbq_torchrl.evaluation.statistics import estimate, summarize
from bbq_torchrl.evaluation.table1 import find_cells
from scripts.docs_blocks.common import RESULTS, block, code, read_csv, table
from scripts.docs_blocks.results import DOMAINS, command, groups
from scripts.docs_blocks.tables import success_rate

LEVEL = 0.6
"""Success of an evaluation that shows that an agent has learned to book."""


@block("learning.plateau")
def _plateau() -> str:
    """Returns the median over seeds of what is predicted, a line for each start."""
    cells: dict[str, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for line in read_csv("plateau.csv"):
        cells[line["start"]][int(line["updates"])].append(float(line["q_value"]))
    # Seeds differ in the length of an epoch by an update or two: the columns are the first start's.
    columns = [f"{updates:,}" for updates in next(iter(cells.values()))]
    rows = [
        (start, *(f"{median(values):.1f}" for values in by_updates.values()))
        for start, by_updates in cells.items()
    ]
    return table(("start, after updates", *columns), rows, numbers=len(columns))


@block("learning.quick")
def _quick() -> str:
    """Returns a line for each seed of the README's first command."""
    (group,) = groups("quick")
    took = {int(line["seed"]): line for line in read_csv("quick_seconds.csv")}
    seeds = [member.seed for member in group.members]
    clocks = [[float(took[seed][clock]) for seed in seeds] for clock in ("wall", "processor")]
    reached = rounds_to_reach(group.evaluation, LEVEL, window=1)
    rounds = ["not reached" if math.isinf(number) else f"{number:.0f}" for number in reached]
    success = [[f"{x:.3f}" for x in (*xs, fmean(xs))] for xs in (group.final, group.cumulative)]
    seconds = [[f"{x:.0f}" for x in (*xs, fmean(xs))] for xs in clocks]
    rows = zip([*seeds, "mean"], *success, [*rounds, ""], *seconds, strict=True)
    head = (
        *("seed", "final success", "cumulative training success"),
        *(f"rounds to {LEVEL}", "seconds", "of a core"),
    )
    wall, processor = map(median, clocks)
    return (
        f"{table(head, rows, numbers=6)}\n\n"
        f"The final success of {len(seeds)} seeds is between {min(group.final):.2f} and "
        f"{max(group.final):.2f}. Rounds to {LEVEL}: until an evaluation while training was there. "
        "Seconds are of the whole command, from the start of the process to its end, on a machine "
        f"of two cores beside another process (median {wall:.0f}), and those of a core that it "
        f"took (median {processor:.0f})."
    )


@block("learning.expect")
def _expect() -> str:
    """Returns what a user of the README's first command can expect."""
    finals = groups("quick")[0].final
    policies = (success_rate("movie", "reference", name) for name in ("rule", "clairvoyant"))
    figures = (min(finals), max(finals), fmean(finals), *policies)
    low, high, mean, rule, ceiling = (f"{value:.2f}".lstrip("0") for value in figures)
    return (
        "What to expect: nothing in the first five rounds, then success rises; "
        f"{len(finals)} fresh seeds end between {low} and {high} of dialogues booked "
        f"(mean {mean}), where the rule agent books {rule} and a privileged policy that reads the "
        f"user's hidden goal {ceiling} "
        "([each seed, and why nothing happens at first](docs/learning_starts.md))."
    )


@block("learning.from_scratch")
def _from_scratch() -> str:
    """Returns what the example in one file came to."""
    ends = [
        f"{float(line['final_success']):.3f} (seed {line['seed']})"
        for line in read_csv("from_scratch.csv")
    ]
    file = "`examples/bbqn_from_scratch.py`"
    return f"The same in one file of plain torch, {file}, ends at {', '.join(ends)}."


@block("learning.search")
def _search() -> str:
    """Returns the trials of every search, the best one first."""
    parts = []
    for file in sorted((RESULTS / "search").glob("*.csv")):
        lines = sorted(read_csv(f"search/{file.name}"), key=lambda line: -float(line["value"] or 0))
        keys = [key for key in lines[0] if "." in key]
        rows = [
            (*(_short(line[key]) for key in keys), f"{float(line['value']):.3f}", line["rounds"])
            for line in lines
        ]
        head = (*map(code, keys), "training success", "rounds")
        parts.append(f"`search={file.stem}`\n\n{table(head, rows, numbers=2)}")
    return "\n\n".join(parts)


def _short(value: str) -> str:
    try:
        return f"{float(value):.3g}"
    except ValueError:
        return value


@block("learning.tried", "tried.csv", "success_rate", "final")
@block("learning.targets", "tried_targets.csv", "late_success", "rounds 26 to 30")
def _tried(file: str, end: str, name: str) -> str:
    """Returns each variant's difference from the first one, by pairs of seeds.

    Args:
        file: a row for each variant and seed.
        end: the column that says how the training ended.
        name: of that column in the table.
    """
    runs: dict[str, list[dict[str, str]]] = defaultdict(list)
    for line in read_csv(file):
        runs[line["variant"]].append(line)
    base, *_ = runs
    rows = []
    for variant, lines in runs.items():
        row = [variant, str(len(lines))]
        for key in ("cumulative_success", end):
            own, first = ([float(line[key]) for line in of] for of in (lines, runs[base]))
            differences = [one - other for one, other in zip(own, first, strict=True)]
            paired = "–" if variant == base else f"{estimate(differences, method='t'):+.3f}"
            row += [f"{fmean(own):.3f}", paired]
        rows.append(row)
    head = ("variant", "seeds", "cumulative", "paired difference", name, "paired difference")
    return table(head, rows, numbers=5)


@block("learning.rate")
def _rate() -> str:
    """Returns agents of Table 1 with a learning rate that falls, by pairs with the constant one."""
    rows, commands = [], []
    for env, title in DOMAINS.items():
        constant, falls = (find_cells(of, env) for of in (groups("table1"), groups("lr_falls")))
        against = [(name, group, constant[name]) for name, group in falls.items()]
        if {"BBQN-MAP", "DQN"} <= falls.keys():
            against.append(("BBQN-MAP minus DQN, both falling", falls["BBQN-MAP"], falls["DQN"]))
        for name, group, other in against:
            differences = pair(group, other).differences
            ends, learns = (
                f"{differences[of].t:+.3f}" for of in ("final_success", "training_success")
            )
            finals = (f"{summarize(of.final).t:.3f}" for of in (other, group))
            own = ("", "") if "minus" in name else finals
            rows.append((title, name, *own, ends, learns))
        commands += [command(run) for group in falls.values() for run in group.runs]
    head = ("trained on", "agent", "constant", "falling", "by pairs", "of all training, by pairs")
    return "\n\n".join([table(head, rows, numbers=4), "\n".join(["```bash", *commands, "```"])])
