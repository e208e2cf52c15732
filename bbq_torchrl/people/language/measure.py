"""Measurements of how well the language layer understands and speaks."""

from __future__ import annotations

import json
import math
import random
import time
from itertools import compress
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from bbq_torchrl.people.language.corpus import make_examples, play
from bbq_torchrl.people.language.generator import Generator
from bbq_torchrl.people.language.training_lines import Line, read_lines, without_unknown
from bbq_torchrl.people.language.understander import (
    SENTENCES,
    Understander,
    keys_of,
    same_frame,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bbq_torchrl.domains import Domain

SUREST = 0.8
"""The share of sentences to answer."""

_CHANCES = 200
_MADE = 2_000
_ROUND_TRIPS = 3_000  # turns


def score(
    understand: Understander, lines: Sequence[Line], change: Callable[[str], str] = str
) -> dict[str, float]:
    """Returns how well labeled lines are understood, by the names in ``results/``.

    ``frame`` and ``act`` are the shares that are exactly right. ``slot_f1`` is the F1 of pairs of
    slot and value, where "does not matter" counts as a value. ``answered`` is the share that the
    system does not ask about again. ``right_of_answered`` and ``right_of_surest`` are the shares of
    right frames among these and among the surest sentences.

    Args:
        understand: the understander.
        lines: the sentences with their meanings.
        change: a change made to each sentence first.
    """
    right, acts, confidences, answered = [], [], [], []
    shared = pairs = 0
    for question, text, label in lines:
        frame = without_unknown(label)
        heard = understand(change(text), question)
        got = keys_of(heard.frame, understand.lexicon).items()
        meant = keys_of(frame, understand.lexicon).items()
        right.append(same_frame(heard.frame, frame, understand.lexicon))
        acts.append(heard.frame.act == frame.act)
        confidences.append(heard.confidence)
        answered.append(not understand.asks(heard))
        shared += len(got & meant)
        pairs += len(got) + len(meant)
    surest = sorted(zip(confidences, right, strict=True), reverse=True)
    surest = surest[: math.ceil(SUREST * len(surest))]
    return {
        "sentences": len(right),
        "frame": fmean(right),
        "slot_f1": 2 * shared / max(pairs, 1),
        "act": fmean(acts),
        "answered": fmean(answered),
        "right_of_answered": fmean(compress(right, answered)) if any(answered) else 1.0,
        "right_of_surest": fmean(is_right for _, is_right in surest),
        "calibration_error": calibration_error(confidences, right),
        "calibration_floor": calibration_floor(confidences),
    }


def calibration_error(confidences: Sequence[float], right: Sequence[bool]) -> float:
    """Returns the expected calibration error in ten bins of confidence."""
    bins: dict[int, float] = {}
    for confidence, is_right in zip(confidences, right, strict=True):
        number = min(int(confidence * 10), 9)
        bins[number] = bins.get(number, 0.0) + confidence - is_right
    return sum(map(abs, bins.values())) / len(right)


def calibration_floor(confidences: Sequence[float]) -> float:
    """Returns the mean calibration error by chance alone, if every confidence is correct."""
    rng = random.Random(0)
    return fmean(
        calibration_error(confidences, [rng.random() < c for c in confidences])
        for _ in range(_CHANCES)
    )


def labeled_files(data: Path, domain: Domain) -> dict[str, list[Line]]:
    """Returns the labeled lines of the text files in a folder, by file name.

    Raises:
        ValueError: if the folder has no text files, or one is written in another way.
    """
    files = {file.stem: read_lines(file, domain) for file in sorted(data.glob("*.txt"))}
    if not any(files.values()):
        raise ValueError(
            f"--data must be a folder with labeled sentences in files *.txt, got {data}"
        )
    return {name: lines for name, lines in files.items() if lines}


def train_measured(
    domain: Domain, sentences: int = SENTENCES, seed: int = 0, labeled: Sequence[Line] = ()
) -> tuple[Understander, dict[str, Any]]:
    """Returns a trained understander, and what its training took; arguments as in training."""
    started = time.process_time()
    understand = Understander.train(domain, sentences=sentences, seed=seed, labeled=labeled)
    seconds = time.process_time() - started
    with TemporaryDirectory() as folder:
        understand.save(file := Path(folder, "understander.npz"))
        size = file.stat().st_size
    return understand, {
        "domain": domain.name,
        "learned_from": sentences,
        "seed": seed,
        "training_seconds": round(seconds, 1),
        "megabytes": round(size / 1e6, 2),
    }


def score_grammar(understand: Understander, seed: int) -> dict[str, float]:
    """Returns the scores of unseen sentences of the domain's grammar; ``seed`` is training's."""
    made = make_examples(understand.lexicon, _MADE, seed + 2)
    return score(understand, [Line(one.question, " ".join(one.words), one.frame) for one in made])


def measure_round_trip(
    understand: Understander, dialogues: int = 10_000, seed: int = 0
) -> dict[str, float]:
    """Returns the shares of simulated users' frames recovered from the grammar's sentences."""
    turns = play(understand.domain, dialogues, seed=seed)[:_ROUND_TRIPS]
    speak = Generator(understand.domain)
    lines = [
        Line(question, speak.user(frame, question, session=number), frame)
        for number, (question, frame) in enumerate(turns)
    ]
    result = score(understand, lines)
    return {
        "turns": len(lines),
        **{f"round_trip_{name}": result[name] for name in ("frame", "slot_f1", "act")},
    }


def as_json(figures: Mapping[str, Any]) -> str:
    """Returns figures as JSON, rounded to four decimals."""
    exact = json.dumps(figures)
    rounded = json.loads(exact, parse_float=lambda text: round(float(text), 4))
    return json.dumps(rounded, indent=1) + "\n"
