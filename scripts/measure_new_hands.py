"""Measures the understanding on hands that it has learned nothing of: ``results/new_hands.json``.

The last two hands of the movie domain's ``learned.txt`` are left out of training and measured.
A hand begins with its terse sentences.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.domains.folder import MOVIE_FOLDER
from bbq_torchrl.language import Understander, read_lines
from bbq_torchrl.language.labeled import LEARNED_FILE
from bbq_torchrl.language.measure import figures, score

_BEGINS = "# terse\n"
RESULT = Path(__file__).parents[1] / "results" / "new_hands.json"


def main() -> None:
    """Trains without the hands, and writes what is understood of each."""
    domain = movie_domain()
    *learned, last, latest = (MOVIE_FOLDER / LEARNED_FILE).read_text("utf-8").split(_BEGINS)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "movie"
        shutil.copytree(MOVIE_FOLDER, folder)
        file = folder / LEARNED_FILE
        file.write_text("".join(learned), encoding="utf-8")
        understand = Understander.train(domain, folder)
        found = []
        for hand in (last, latest):
            file.write_text(hand, encoding="utf-8")
            own = figures(score(understand, read_lines(file, domain)))
            found.append({name: round(value, 4) for name, value in own.items()})
    RESULT.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
