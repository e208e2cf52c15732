"""Writes the movie corpus that comes with the package: records, goals and values.

The corpus is ours. Its statistics are those of the public corpus that the reference setting is
calibrated on (how sparse the records are, what goals constrain and request, how many goals no
record meets); its content is made from the public facts in ``movie_corpus/facts.yaml``.

    python scripts/make_movie_corpus.py     rewrites bbq_torchrl/domains/movie

Run it after a change to the parts or the facts; the same parts and facts always give the same
bytes.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python scripts/make_movie_corpus.py` finds its own parts

from bbq_torchrl.domains.folder import SHIPPED, save_data  # noqa: E402
from scripts.movie_corpus.dice import Dice  # noqa: E402
from scripts.movie_corpus.goals import GoalWriter  # noqa: E402
from scripts.movie_corpus.records import SHARES, RecordWriter, make_values  # noqa: E402

FACTS = ROOT / "scripts" / "movie_corpus" / "facts.yaml"
SEED = 2021


def main() -> None:
    """Writes the three data files of the movie domain."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=SHIPPED["movie"], help="where the files go")
    write_corpus(parser.parse_args().folder)


def write_corpus(folder: Path) -> None:
    """Writes ``knowledge_base.csv``, ``goals.jsonl`` and ``values.json`` into ``folder``."""
    facts = yaml.safe_load(FACTS.read_text(encoding="utf-8"))
    dice = Dice(SEED)
    writer = RecordWriter(facts, dice)
    sessions = writer.sessions()
    values = make_values(writer)
    goals = GoalWriter(facts, dice, sessions, values).goals()
    records = [record for session in sessions for record in session]
    save_data(folder, list(SHARES), records, goals, values)


if __name__ == "__main__":
    main()
