"""How the benchmarks compare times."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from benchmarks.parts import timing
from benchmarks.parts.timing import interleaved, stopwatch


def test_slow_spell_that_hits_both_leaves_the_ratio() -> None:
    clock = iter([1.0, 2.0, 1.0, 20.0, 10.0, 20.0, 10.0, 2.0, 1.0])
    result = interleaved(lambda: next(clock), lambda: next(clock), repeats=4)
    # 2 / 1; 20 between 1 and 10; 20 between two of 10; 2 between 10 and 1
    assert result.ratio == pytest.approx((2.0 + 2.0) / 2)
    assert result.seconds == 11.0


def test_stopwatch_times_every_call_and_lets_go(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(timing, "perf_counter", lambda: clock[0])

    def work(ticks: float) -> str:
        clock[0] += ticks
        return "done"

    owner = SimpleNamespace(work=work)
    with stopwatch(owner, "work") as seconds:
        assert owner.work(3.0) == owner.work(20.0) == "done"
    assert seconds == [3.0, 20.0]
    assert owner.work is work
