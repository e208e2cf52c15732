"""The progress bar."""

from __future__ import annotations

import multiprocessing
import re
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


def test_it_shows_means_over_the_replicas_and_the_expected_end(capsys):
    bar = RoundProgress(10, done=4, visible=True)

    bar.update([row(0), row(1)])
    bar.close()

    shown = capsys.readouterr()
    assert shown.out == ""
    last = shown.err.split("\r")[-1]
    assert "5/10" in last
    for part in ("success=0.50", "reward=-8.0", "kl=100", "s/round=2.0"):
        assert part in last
    assert re.search(r"end=\d\d:\d\d:\d\d", last)


def test_agents_without_a_kl_show_none(capsys):
    bar = RoundProgress(2, visible=True)
    rows = [row(0)]
    del rows[0]["kl"]

    bar.update(rows)
    bar.close()

    assert "kl" not in capsys.readouterr().err


def test_runs_side_by_side_do_not_draw_over_one_another(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for parent, is_shown in ((None, True), (object(), False)):
        monkeypatch.setattr(multiprocessing, "parent_process", lambda parent=parent: parent)
        RoundProgress(2).close()
        assert bool(capsys.readouterr().err) is is_shown


def test_it_is_quiet_where_there_is_no_terminal(capsys):
    for visible in (None, False):
        bar = RoundProgress(2, visible=visible)
        bar.update([row(0)])
        bar.close()

    assert capsys.readouterr().err == ""
