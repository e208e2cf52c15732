"""Condenses benchmarks without spiking into ``results/unspiked.csv``, a row for each seed.

    bbq bench runs/unspiked_hotel --agents <agents> --domains hotel --errors reference \
        --budgets 500 1000 2000 --set protocol=quick protocol.lr_final=1 spike=none threads=1
    bbq bench runs/unspiked_movie --agents <agents> --domains movie --errors reference \
        --budgets 2000 7500 --set protocol=quick protocol.lr_final=1 spike=none threads=1
    python scripts/measure_unspiked.py runs/unspiked_hotel runs/unspiked_movie

docs/results.md has the agents. Rows of other agents stay as they are. ``first_success`` counts
training dialogues in whole rounds.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from pathlib import Path
from typing import Any

from bbq_torchrl.evaluation.curves import booked, rounds_to_reach
from bbq_torchrl.evaluation.finished_runs import read_runs
from bbq_torchrl.utils import output

RESULT = Path(__file__).parents[1] / "results" / "unspiked.csv"
LEVEL = 0.3


def rows(folder: Path) -> list[dict[str, Any]]:
    """Returns a row for each seed of a benchmark's finished cells."""
    found = []
    about = json.loads((folder / "bench.json").read_text(encoding="utf-8"))
    missing = " ".join(about["missing"])
    for cell in about["cells"]:
        agent, _, domain = cell["cell"].partition(",")[0].partition(" on ")
        if cell["cell"] in missing:
            output.write(f"missing: {cell['cell']}\n")
            continue
        for replica in read_runs(folder / domain / "errors_reference" / agent):
            success = replica.metrics["success_rate"][:, [replica.number]]
            size = int(replica.metrics["dialogues"][0, replica.number])
            dialogues = len(success) * size
            reached = {
                "first_success": rounds_to_reach(success > 0, 1.0, window=1)[0] * size,
                f"to_{LEVEL}": rounds_to_reach(success, LEVEL)[0] * size,
            }
            found.append(
                {
                    "domain": domain,
                    "agent": agent,
                    "replica": replica.number,
                    "dialogues": dialogues,
                    **{name: int(n) if math.isfinite(n) else "" for name, n in reached.items()},
                    **{f"booked_{n}": booked(success, size, n)[0] for n in (1_000, 2_000)},
                    "booked": booked(success, size, dialogues)[0],
                    "final": replica.own.success_rate,
                    "commit": cell["commit"][:8],
                }
            )
    return found


def main() -> None:
    """Writes the rows of all folders, and keeps those of agents that they do not have."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path, help="of bbq bench")
    found = [row for folder in parser.parse_args().folders for row in rows(folder)]
    new = {(row["domain"], row["agent"]) for row in found}
    with RESULT.open(encoding="utf-8") as file:
        kept = [row for row in csv.DictReader(file) if (row["domain"], row["agent"]) not in new]
    with RESULT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(found[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(kept + found)


if __name__ == "__main__":
    main()
