"""The time to learn counts to the first good evaluation, and says what was cut off."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from benchmarks.parts import processes, time_to_learn
from benchmarks.parts.processes import Used
from benchmarks.parts.sizes import FULL
from benchmarks.parts.time_to_learn import Learned


@pytest.mark.parametrize(
    ("evaluations", "learned"),
    [
        ([math.nan, 0.59, math.nan, 0.6, 0.7], Learned(4.0, True, 4)),
        ([math.nan, 0.2, 0.3], Learned(3.0, False, 3)),
    ],
)
def test_training_ends_with_the_first_evaluation_that_reaches_the_level(
    monkeypatch: pytest.MonkeyPatch, evaluations: list[float], learned: Learned
) -> None:
    """A round takes a second."""
    clock = [10.0]
    rates = iter(evaluations)

    def train_round() -> list[dict[str, float]]:
        clock[0] += 1
        return [{"eval_success_rate": next(rates)}]

    trainer = SimpleNamespace(begin=lambda: None, train_round=train_round)
    monkeypatch.setattr(time_to_learn, "build_trainer", lambda *_: (trainer, None))
    monkeypatch.setattr(time_to_learn, "process_time", lambda: clock[0])
    assert time_to_learn.train([], len(evaluations)) == learned


@pytest.mark.parametrize(
    ("seconds", "measured", "is_bound", "remark"),
    [
        ([30, 50, 40, 20, 10], 32, False, "5 of 5 reached it within 25 rounds"),
        # Those cut off count as longer than all others, however fast their rounds were.
        ([30, 50, 40, None, None], 52, False, "3 of 5 reached it within 25 rounds"),
        ([30, 50, None, None, None], 47, True, "2 of 5 reached it within 25 rounds"),
    ],
)
def test_the_median_says_what_was_cut_off(
    monkeypatch: pytest.MonkeyPatch,
    seconds: list[float | None],
    measured: float,
    is_bound: bool,
    remark: str,
) -> None:
    asked: list[list[str]] = []

    def train(overrides: list[str], rounds: int) -> Learned:
        assert rounds == FULL.learning_rounds
        took = seconds[len(asked) % 5]
        asked.append(overrides)
        return Learned(45, False, 25) if took is None else Learned(took, True, 25)

    monkeypatch.setattr(time_to_learn, "train", train)
    monkeypatch.setattr(processes, "python", lambda *_: Used(wall=9, cpu=2, peak_bytes=1))
    rows = time_to_learn.time_to_learn(FULL)
    assert [row.what.partition(",")[0] for row in rows] == ["bbqn-map", "dqn"]
    for row in rows:
        assert (row.measured, row.is_bound, row.remark) == (measured, is_bound, remark)
        assert row.reached == (measured <= 60 and not is_bound)
    assert [overrides[-1] for overrides in asked[:5]] == [f"seed={seed}" for seed in range(5)]
    assert all("protocol=quick" in overrides for overrides in asked)
