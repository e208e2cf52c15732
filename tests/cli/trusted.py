"""Tiny runs whose folders are damaged, copied and gone on with, and what is said of them."""

from __future__ import annotations

import csv

from bbq_torchrl.cli.folders import LOCK
from bbq_torchrl.cli.store import compose
from bbq_torchrl.run import run

TINY = (
    "agent=dqn",
    "explore=greedy",  # no schedule, which would fall over the share of other rounds
    "env.max_turn=8",
    "agent.hidden=[8]",
    "protocol.rounds=3",
    "protocol.dialogues=2",
    "protocol.capacity=200",
    "protocol.eval_dialogues=4",
    "protocol.eval_batch=4",
    "protocol.eval_every=0",
    "spike.dialogues=2",
)


def one_line(capsys):
    out, err = capsys.readouterr()
    assert not out
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


def state_of(folder):
    return {
        path.relative_to(folder): (path.stat().st_mtime_ns, path.read_bytes())
        for path in folder.rglob("*")
        if path.is_file() and path.name != LOCK
    }


def rows(folder):
    with (folder / "metrics.csv").open(newline="") as file:
        return [
            {name: value for name, value in row.items() if not name.startswith("seconds")}
            for row in csv.DictReader(file)
        ]


def resumed(folder, *overrides):
    """Goes on with a run as ``train.py resume=<folder>`` does, in this process."""
    from bbq_torchrl.cli.resume import resumed_config

    arguments = [f"resume={folder}", *overrides]
    return run(resumed_config(compose(arguments), arguments), folder)
