"""``bbq report``: compares finished runs over their seeds."""

from __future__ import annotations

if __name__ == "__main__":  # before anything that takes time to import
    from bbq_torchrl.utils import interruption

    interruption.listen()

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bbq_torchrl.evaluation.comparison import comparison_report
from bbq_torchrl.evaluation.designs import ablations_report, grid_report
from bbq_torchrl.evaluation.finished_runs import find_results, find_unfinished
from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.evaluation.table1 import table1_report
from bbq_torchrl.utils import interruption, output

if TYPE_CHECKING:
    from collections.abc import Sequence

FORMS = {
    "table1": (
        table1_report,
        "the paper's Table 1: its numbers next to ours, declared pairs, and missing cells",
    ),
    "grid": (grid_report, "learner x explorer: each learner by each exploration"),
    "ablations": (
        ablations_report,
        "runs that each change one key of a reference; of one key alone, give that first",
    ),
}
"""Flag -> the function that makes the report, and its help."""


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code."""
    interruption.tell(lambda: "in a report", lambda: "the same command starts again")
    parser = output.Parser(
        prog="python -m bbq_torchrl.evaluation.compare_runs",
        description="Compares finished runs over their seeds: prints the tables as Markdown.",
    )
    parser.add_argument(
        "folders", nargs="+", type=Path, help="run folders, or folders with run folders below them"
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="folder for the report as Markdown, its tables and replicas as CSV, its figures as "
        "PNG and SVG",
    )
    forms = parser.add_mutually_exclusive_group()
    for name, (make, meaning) in FORMS.items():
        forms.add_argument(f"--{name}", dest="make", action="store_const", const=make, help=meaning)
    parser.set_defaults(make=comparison_report)
    given = parser.parse_args(arguments)
    report = given.make(read_groups(find_results(given.folders)))
    if left_out := find_unfinished(given.folders):
        named = f"Left out, since not finished: {', '.join(map(str, left_out))}."
        report = replace(report, parts=[named, *report.parts])
    if given.out is not None:
        report.write(given.out)
    output.write(str(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
