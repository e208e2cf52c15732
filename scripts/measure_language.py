"""Measures the nlu and the nlg of the movie domain: ``results/language.json``.

The sentences of ``tests/data/language`` were never learned or chosen by.
"""

from __future__ import annotations

import random
import time
from pathlib import Path
from statistics import fmean
from typing import Any

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.people.language.__main__ import (
    as_json,
    labeled_files,
    measure_round_trip,
    score,
    train_measured,
)
from bbq_torchrl.people.language.paraphrase import with_typos
from bbq_torchrl.utils import output

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "results" / "language.json"
VOICES = ("terse", "chatty", "nonnative")
LATER = ("second_held_out", "third_held_out", "strangers")
"""Files of sentences written after the phrases and features."""

_TYPOS, _DRAWS = 0.1, 5


def lowered(text: str) -> str:
    """Returns a text in lower case, without marks except those inside numbers and words."""
    kept = [
        letter
        for at, letter in enumerate(text)
        if letter.isalnum()
        or letter.isspace()
        or letter in "$%&@'"
        or (0 < at < len(text) - 1 and text[at - 1].isalnum() and text[at + 1].isalnum())
    ]
    return " ".join("".join(kept).lower().split())


def measure() -> dict[str, Any]:
    """Returns all figures."""
    domain = movie_domain()
    files = labeled_files(ROOT / "tests" / "data" / "language", domain)
    lines = [line for voice in VOICES for line in files[voice]]
    understand, figures = train_measured(domain)
    started = time.process_time()
    for question, text, _ in lines:
        understand(text, question)
    seconds = time.process_time() - started
    found = {name: score(understand, own) for name, own in files.items()}
    whole, rng = score(understand, lines), random.Random(0)
    typed = [
        score(understand, lines, lambda text: " ".join(with_typos(text.split(), _TYPOS, rng)))
        for _ in range(_DRAWS)
    ]
    return {
        **figures,
        "free": whole,
        **{name: found[name] for name in LATER},
        "voices": {
            voice: {name: found[voice][name] for name in ("frame", "slot_f1", "act")}
            for voice in VOICES
        },
        "threshold": understand.threshold,
        "typos_cost_slot_f1": whole["slot_f1"] - fmean(own["slot_f1"] for own in typed),
        "lowered_cost_slot_f1": whole["slot_f1"] - score(understand, lines, lowered)["slot_f1"],
        "other_hand_slot_f1": found["other_hand"]["slot_f1"],
        "milliseconds_a_sentence": 1e3 * seconds / len(lines),
        **measure_round_trip(understand),
    }


if __name__ == "__main__":
    text = as_json(measure())
    output.write(text)
    RESULT.write_text(text, encoding="utf-8")
