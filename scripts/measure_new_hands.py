"""Measures the nlu on writers left out of its training: ``results/new_hands.json``.

The writers ("hands") measured are the last seven of the movie domain's ``learned.txt``, of which
every other one is left out at a time. A hand begins with its terse sentences.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

from bbq_torchrl.domains import load_domain
from bbq_torchrl.domains.folder import SHIPPED
from bbq_torchrl.people.language import Understander, read_lines
from bbq_torchrl.people.language.__main__ import score
from bbq_torchrl.people.language.training_lines import LEARNED_FILE

_BEGINS = "# terse\n"
_NEW = 7
RESULT = Path(__file__).parents[1] / "results" / "new_hands.json"


def main() -> None:
    """Trains without these writers, and writes the accuracy on each."""
    hands = (SHIPPED["movie"] / LEARNED_FILE).read_text("utf-8").split(_BEGINS)
    found = {}
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "movie"
        shutil.copytree(SHIPPED["movie"], folder)
        file = folder / LEARNED_FILE
        domain = load_domain(folder)
        for start in (0, 1):
            left_out = range(len(hands) - _NEW + start, len(hands), 2)
            kept = [hand for at, hand in enumerate(hands) if at not in left_out]
            file.write_text(_BEGINS.join(kept), encoding="utf-8")
            understand = Understander.train(domain)
            for at in left_out:
                file.write_text(hands[at], encoding="utf-8")
                own = score(understand, read_lines(file, domain))
                found[at] = {name: round(value, 4) for name, value in own.items()}
    content = [{"hand": at, **found[at]} for at in sorted(found)]
    RESULT.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
