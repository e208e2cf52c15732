"""What a whole run spends its time on: start, playing, updates, bookkeeping, final evaluation.

    OMP_NUM_THREADS=1 python benchmarks/whole_run.py                       agent=bbqn env=full
    OMP_NUM_THREADS=1 python benchmarks/whole_run.py agent=dqn replicas=5

Runs the configuration as ``train.py`` does (400 rounds of ``agent=bbqn env=full`` take minutes) and
prints seconds and shares, counted from the start of the process.
"""

from __future__ import annotations

import time

STARTED = time.perf_counter()

import argparse  # noqa: E402
import resource  # noqa: E402
import sys  # noqa: E402
import tempfile  # noqa: E402
from collections import Counter  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import TYPE_CHECKING  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python benchmarks/whole_run.py` finds its own packages

from bbq_torchrl import run as run_module  # noqa: E402
from bbq_torchrl.cli.store import compose  # noqa: E402
from bbq_torchrl.evaluation.markdown import table  # noqa: E402
from benchmarks.parts.accounts import RoundAccounts  # noqa: E402
from benchmarks.parts.rows import number  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Sequence


def account(overrides: Sequence[str], folder: Path) -> dict[str, float]:
    """Runs a configuration. Returns the seconds of each kind of work since the process began."""
    spent: Counter[str] = Counter()
    build, evaluate = run_module.build_trainer, run_module.evaluate

    def build_watched(*arguments):
        trainer, agent = build(*arguments)
        accounts = RoundAccounts(trainer)
        train_round = accounts.train_round

        def watched_round():
            rows, seconds = train_round()
            spent.update({kind: seconds[kind] for kind in ("playing", "updates")})
            return rows

        trainer.train_round = watched_round
        return trainer, agent

    def evaluate_watched(*arguments, **settings):
        started = time.perf_counter()
        played = evaluate(*arguments, **settings)
        spent["evaluation"] += time.perf_counter() - started
        return played

    started = time.perf_counter()
    run_module.build_trainer, run_module.evaluate = build_watched, evaluate_watched
    try:
        run_module.run(compose(overrides), folder)
    finally:
        run_module.build_trainer, run_module.evaluate = build, evaluate
    spent["start"] = started - STARTED
    whole = time.perf_counter() - STARTED
    return {"whole": whole, **spent, "bookkeeping": whole - sum(spent.values())}


def main() -> None:
    """Runs and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("overrides", nargs="*", help="default: agent=bbqn env=full")
    overrides = parser.parse_args().overrides or ["agent=bbqn", "env=full"]
    with tempfile.TemporaryDirectory() as folder:
        run_folder = Path(folder) / "run"
        run_folder.mkdir()
        spent = account(overrides, run_folder)
    whole = spent["whole"]
    print(
        table(
            ("what", "seconds", "% of the run"),
            [(kind, number(s), number(100 * s / whole)) for kind, s in spent.items()],
            numbers=2,
        )
    )
    outside = spent["start"] + spent["bookkeeping"]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    print(f"\noutside simulator and updates: {100 * outside / whole:.2f} %; {peak:.2f} GB at most")


if __name__ == "__main__":
    main()
