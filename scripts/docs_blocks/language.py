"""How well the language layer understands, from results/language.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from scripts.docs_blocks.markdown import table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["language_blocks"]

FILE = Path(__file__).resolve().parents[2] / "results" / "language.json"
UNMEASURED = "Not measured yet; `python -m bbq_torchrl.language measure` does."
_ROWS = (
    ("frame exactly right, free sentences", "frame", "≥ .85"),
    ("slot F1, free sentences", "slot_f1", "≥ .93"),
    ("act right, free sentences", "act", "≥ .95"),
    ("slot F1, templates of another hand", "other_hand_slot_f1", "≥ .97"),
    ("answered without asking again", "answered", "≥ .80"),
    ("right among the answered", "right_of_answered", "≥ .95"),
    ("calibration error", "calibration_error", "≤ .05"),
    ("slot F1 lost by typos in 10 % of the words", "typos_cost_slot_f1", "≤ .05"),
    ("slot F1 lost by lower case without marks", "lowered_cost_slot_f1", "≤ .01"),
    ("round trip, frame exactly right", "round_trip_frame", "≥ .97"),
    ("round trip, slot F1", "round_trip_slot_f1", ""),
    ("training, seconds of one core", "training_seconds", "≤ 60"),
    ("size, MB", "megabytes", "≤ 3"),
    ("milliseconds a sentence", "milliseconds_a_sentence", "≤ 5"),
)


def language_blocks() -> dict[str, Callable[[], str]]:
    """Returns the block of measured quality, and that of the voices."""
    return {"language.quality": _quality, "language.voices": _voices}


def _quality() -> str:
    if not FILE.is_file():
        return UNMEASURED
    measured = json.loads(FILE.read_text(encoding="utf-8"))
    rows = [(what, f"{measured[key]:.3g}", aim) for what, key, aim in _ROWS]
    return table(("", "measured", "aim"), rows)


def _voices() -> str:
    if not FILE.is_file():
        return UNMEASURED
    voices = json.loads(FILE.read_text(encoding="utf-8"))["voices"]
    rows = [
        (voice, *(f"{figures[key]:.3f}" for key in ("frame", "slot_f1", "act")))
        for voice, figures in voices.items()
    ]
    return table(("voice", "frame", "slot F1", "act"), rows)
