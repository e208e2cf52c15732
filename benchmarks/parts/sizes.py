"""The sizes of a comparison."""

from __future__ import annotations

from typing import NamedTuple


class Sizes(NamedTuple):
    """The sizes of the published figures.

    Attributes:
        dialogues: played in parallel, for each of the targets.
        capacity: transitions in the buffer of a single network.
        many: replicas side by side, and transitions in the buffer of each.
        repeats: learning phases of each agent; times that dialogues are played.
        bare_updates: of the yardstick in a block.
        rounds: of the accounts, after one to warm up.
        eval_dialogues: of the evaluation.
        memory: of the run whose memory is measured.
        learning_seeds: trainings of each agent, until it has learned.
        learning_rounds: of each of these at most.
        learning_overrides: of the configuration of these.
        overrides: of every configuration.
    """

    dialogues: tuple[int, int, int] = (50, 1_000, 16_384)
    capacity: int = 10_000
    many: tuple[int, int] = (10, 3_200)
    repeats: int = 5
    bare_updates: int = 300
    rounds: int = 3
    eval_dialogues: int = 10_000
    memory: tuple[str, ...] = ("replicas=5", "spike.dialogues=500", "protocol.rounds=3")
    learning_seeds: int = 5
    learning_rounds: int = 100
    learning_overrides: tuple[str, ...] = ()
    overrides: tuple[str, ...] = ()


FULL = Sizes()

TINY = Sizes(
    dialogues=(2, 3, 4),
    capacity=64,
    many=(2, 64),
    repeats=1,
    bare_updates=3,
    rounds=1,
    eval_dialogues=8,
    memory=("replicas=2", "spike.dialogues=2", "protocol.rounds=1"),
    learning_seeds=1,
    learning_rounds=3,
    learning_overrides=(
        "protocol.rounds=2",
        "protocol.eval_every=1",
        "protocol.eval_every_dialogues=4",
        "spike.dialogues=4",
    ),
    overrides=("protocol.dialogues=6",),
)
"""Sizes that run every line in seconds; the figures are meaningless."""
