"""The progress bar."""

from __future__ import annotations

import logging
import math
import multiprocessing
import sys

from bbq_torchrl.trainers import RoundProgress


def row(replica: int, **changed: float) -> dict[str, int | float]:
    return {
        "round": 0,
        "replica": replica,
        "success_rate": 0.25 + 0.5 * replica,
        "reward": -10.0 + 4 * replica,
        "kl": 100.0,
        "seconds": 2.0,
        **changed,
    }


def test_the_bar_shows_means_over_the_replicas_and_the_last_evaluation(capsys):
    bar = RoundProgress(10, done=4, visible=True)
    for evaluated in (math.nan, 0.5, math.nan):
        bar.update([row(r, eval_success_rate=evaluated) for r in (0, 1)])
    bar.close()

    shown = capsys.readouterr()
    assert shown.out == ""
    assert "nan" not in shown.err
    last = shown.err.split("\r")[-1]
    for part in ("7/10", "success=0.50", "reward=-8.0", "eval=0.50", "kl=100"):
        assert part in last


def test_runs_side_by_side_do_not_draw_over_one_another(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for parent, is_shown in ((None, True), (object(), False)):
        monkeypatch.setattr(multiprocessing, "parent_process", lambda parent=parent: parent)
        RoundProgress(2).close()
        assert bool(capsys.readouterr().err) is is_shown


def lines(caplog, rounds: int, rows_of, **options) -> list[str]:
    with caplog.at_level(logging.INFO, "bbq_torchrl"):
        progress = RoundProgress(rounds, visible=False, **options)
        for number in range(options.get("done", 0), rounds):
            progress.update(rows_of(number))
        progress.close()
    return caplog.messages


def test_a_short_training_without_a_bar_logs_every_round(caplog):
    said = lines(
        caplog,
        3,
        lambda number: [row(r, eval_success_rate=0.4 if number == 1 else math.nan) for r in (0, 1)],
        name="a_run",
    )
    assert said == [
        "a_run: round 1 of 3: success 0.50, reward -8.0, 2.0 s a round",
        "a_run: round 2 of 3: success 0.50, evaluation 0.40, reward -8.0, 2.0 s a round",
        "a_run: round 3 of 3: success 0.50, reward -8.0, 2.0 s a round",
    ]


def test_a_long_training_logs_at_most_forty_lines_with_means_of_the_rounds_between(caplog):
    said = lines(
        caplog,
        82,
        lambda number: [
            row(
                0,
                success_rate=(number % 3) / 2,
                eval_success_rate={3: 0.1, 4: 0.2}.get(number, math.nan),
            )
        ],
    )
    assert len(said) == 28  # after every third round, and after the last
    # Rounds 1 to 3 have 0, .5 and 1; the last evaluation, of round 5, is in the line after round 6.
    assert said[0].startswith("round 3 of 82: success 0.50, reward")
    assert said[1].startswith("round 6 of 82: success 0.50, evaluation 0.20, reward")
    assert said[-1].startswith("round 82 of 82: success 0.00")
