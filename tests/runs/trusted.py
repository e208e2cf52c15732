"""Tiny runs whose folders are damaged, copied and gone on with."""

import tiny
from tiny import TINY

from bbq_torchrl.runs.train import run
from bbq_torchrl.utils.files import LOCK

DQN = (
    *TINY,
    "agent=dqn",
    "explore=greedy",  # no schedule, which would fall over the share of other rounds
    "protocol.rounds=3",
    "protocol.eval_every=0",
    "protocol.checkpoint_every=10",
    "protocol.keep_checkpoints=weights",
)

SMALL = (*TINY, "protocol.rounds=3", "protocol.eval_dialogues=30", "protocol.eval_batch=30")


def state_of(folder):
    return {
        path.relative_to(folder): (path.stat().st_mtime_ns, path.read_bytes())
        for path in folder.rglob("*")
        if path.is_file() and path.name != LOCK
    }


def resumed(folder, *overrides):
    """Goes on with a run as ``train.py resume=<folder>`` does, in this process."""
    return run(tiny.resumed(folder, *overrides), folder)
