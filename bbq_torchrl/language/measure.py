"""How well the language layer understands and speaks, as one table of numbers."""

from __future__ import annotations

import math
import random
import re
import statistics
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bbq_torchrl.language.frames import AVAILABLE_TEXT, Frame
from bbq_torchrl.language.labeled import Line, read_lines
from bbq_torchrl.language.noise import lowered, with_typos
from bbq_torchrl.language.templates import Piece, expand, parse, plain
from bbq_torchrl.language.understand import keys_of, same_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from bbq_torchrl.language.generate import Generator
    from bbq_torchrl.language.understand import Understander

__all__ = [
    "VOICES",
    "Score",
    "figures",
    "measure_lines",
    "measure_round_trip",
    "other_hand",
    "score",
]

VOICES = ("terse", "chatty", "nonnative")
LATER = ("second_held_out", "third_held_out")
"""Files of sentences that were written when phrases and features were there."""

SUREST = 0.8
"""The share of sentences that are to be answered."""

_FILLS = 4
_TYPOS = 0.1
_DRAWS = 5
_CHANCES = 200


@dataclass
class Score:
    """How many frames, acts and values of some sentences were understood.

    Attributes:
        frames: for each sentence whether its frame is exactly right.
        acts: the same of its act.
        confidences: how sure the understanding was.
        asked: whether it would rather ask again.
        right: values understood as meant.
        wrong: values understood that were not meant.
        missed: values meant that were not understood.
    """

    frames: list[bool]
    acts: list[bool]
    confidences: list[float]
    asked: list[bool]
    right: int = 0
    wrong: int = 0
    missed: int = 0

    @property
    def frame(self) -> float:
        """The share of frames that are exactly right."""
        return statistics.fmean(self.frames)

    @property
    def act(self) -> float:
        """The share of acts that are right."""
        return statistics.fmean(self.acts)

    @property
    def slot_f1(self) -> float:
        """The F1 of (slot, value) pairs; "does not matter" counts as a value."""
        return 2 * self.right / max(2 * self.right + self.wrong + self.missed, 1)

    @property
    def calibration_error(self) -> float:
        """The expected calibration error in ten bins of confidence."""
        return _calibration_error(self.confidences, self.frames)

    @property
    def calibration_floor(self) -> float:
        """The mean calibration error by chance alone, if each confidence were true."""
        rng = random.Random(0)
        return statistics.fmean(
            _calibration_error(self.confidences, [rng.random() < c for c in self.confidences])
            for _ in range(_CHANCES)
        )

    @property
    def answered(self) -> float:
        """The share of sentences that are answered without asking again."""
        return 1.0 - statistics.fmean(self.asked)

    @property
    def right_of_answered(self) -> float:
        """The share of frames exactly right among the answered ones."""
        kept = [right for right, asked in zip(self.frames, self.asked, strict=True) if not asked]
        return statistics.fmean(kept) if kept else 1.0

    def right_of_surest(self, share: float) -> float:
        """Returns the share of frames exactly right among the surest sentences.

        Args:
            share: of the sentences, how many are looked at.
        """
        surest = sorted(zip(self.confidences, self.frames, strict=True), reverse=True)
        return statistics.fmean(right for _, right in surest[: math.ceil(share * len(surest))])


def _calibration_error(confidences: Sequence[float], right: Sequence[bool]) -> float:
    bins: dict[int, float] = {}
    for confidence, is_right in zip(confidences, right, strict=True):
        number = min(int(confidence * 10), 9)
        bins[number] = bins.get(number, 0.0) + confidence - is_right
    return sum(map(abs, bins.values())) / len(right)


def score(
    understand: Understander, lines: Sequence[Line], change: Callable[[str], str] = str
) -> Score:
    """Returns how well labeled lines are understood.

    Args:
        understand: who understands.
        lines: the sentences with what they mean.
        change: what is done to a sentence before.
    """
    result = Score([], [], [], [])
    for question, text, frame in lines:
        heard = understand(change(text), question)
        got = set(keys_of(heard.frame, understand.lexicon).items())
        meant = set(keys_of(frame, understand.lexicon).items())
        result.frames.append(same_frame(heard.frame, frame, understand.lexicon))
        result.acts.append(heard.frame.act == frame.act)
        result.confidences.append(heard.confidence)
        result.asked.append(understand.asks(heard))
        result.right += len(got & meant)
        result.wrong += len(got - meant)
        result.missed += len(meant - got)
    return result


def other_hand(understand: Understander, path: Path) -> list[Line]:
    """Returns the templates of another hand, each filled with values of the domain.

    Args:
        understand: whose domain's values are filled in.
        path: the file; its README says how it is written.
    """
    lexicon, rng = understand.lexicon, random.Random(0)
    lines = []
    for row in path.read_text(encoding="utf-8").splitlines():
        if not row.strip() or row.startswith("#"):
            continue
        said, text, meaning = (part.strip() for part in row.split("|"))
        template = parse(text)
        slots = dict.fromkeys(name for kind, name in template.names() if kind == "slot")
        for _ in range(_FILLS):
            values = {slot: rng.choice(lexicon.values(slot)) for slot in slots}
            pieces = {slot: [Piece(value, slot)] for slot, value in values.items()}
            frame = _meant(meaning, values)
            question = _said(said, understand, rng)
            lines.append(Line(question, plain(expand(template, pieces, {}, rng)), frame))
    return lines


def _meant(meaning: str, values: dict[str, str]) -> Frame:
    act, _, _ = meaning.partition("(")
    asked = re.search(r"request\((.+?)\)", meaning)
    return Frame(act, values, tuple(asked[1].split(", ")) if asked else ())


def _said(said: str, understand: Understander, rng: random.Random) -> Frame | None:
    if not said:
        return None
    frame = Frame.parse(said.replace("inform(", "request("))
    if not said.startswith("inform"):
        return frame
    slot = frame.requests[0]
    if slot == understand.domain.complete_slot:
        return Frame("inform", {slot: AVAILABLE_TEXT})
    return Frame("inform", {slot: rng.choice(understand.lexicon.values(slot))})


def measure_lines(understand: Understander, data: Path) -> dict[str, Any]:
    """Returns the figures of the labeled sentences in a folder.

    Args:
        understand: who understands.
        data: the folder.
    """
    by_voice = {voice: read_lines(data / f"{voice}.txt", understand.domain) for voice in VOICES}
    lines = [line for own in by_voice.values() for line in own]
    whole = score(understand, lines)
    rng = random.Random(0)
    typed = [
        score(understand, lines, lambda text: " ".join(with_typos(text.split(), _TYPOS, rng)))
        for _ in range(_DRAWS)
    ]
    started = time.process_time()
    for question, text, _ in lines:
        understand(text, question)
    seconds = time.process_time() - started
    later = {
        name: figures(score(understand, read_lines(data / f"{name}.txt", understand.domain)))
        for name in LATER
    }
    return {
        "free": figures(whole),
        **later,
        "voices": {
            voice: {"frame": s.frame, "slot_f1": s.slot_f1, "act": s.act}
            for voice, s in ((voice, score(understand, own)) for voice, own in by_voice.items())
        },
        "threshold": understand.threshold,
        "typos_cost_slot_f1": whole.slot_f1 - statistics.fmean(s.slot_f1 for s in typed),
        "lowered_cost_slot_f1": whole.slot_f1 - score(understand, lines, lowered).slot_f1,
        "other_hand_slot_f1": score(
            understand, other_hand(understand, data / "other_hand.txt")
        ).slot_f1,
        "milliseconds_a_sentence": 1e3 * seconds / len(lines),
    }


def figures(result: Score) -> dict[str, float]:
    """Returns the figures of a score by their names in ``results/``."""
    return {
        "sentences": len(result.frames),
        "frame": result.frame,
        "slot_f1": result.slot_f1,
        "act": result.act,
        "answered": result.answered,
        "right_of_answered": result.right_of_answered,
        "right_of_surest": result.right_of_surest(SUREST),
        "calibration_error": result.calibration_error,
        "calibration_floor": result.calibration_floor,
    }


def measure_round_trip(
    understand: Understander, generator: Generator, turns: Sequence[tuple[Frame | None, Frame]]
) -> dict[str, float]:
    """Returns the share of frames that come back from the own sentences.

    Args:
        understand: who understands.
        generator: who speaks.
        turns: the agent's last act and what the user means.
    """
    lines = [
        Line(question, generator.user(frame, question, session=number), frame)
        for number, (question, frame) in enumerate(turns)
    ]
    result = score(understand, lines)
    return {
        "turns": len(lines),
        "round_trip_frame": result.frame,
        "round_trip_slot_f1": result.slot_f1,
        "round_trip_act": result.act,
    }
