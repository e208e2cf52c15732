"""How much of everything a comparison measures."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.parts.learning import TINY_CAPACITY, TINY_OVERRIDES


@dataclass(frozen=True)
class Sizes:
    """The sizes that the figures are published for.

    Attributes:
        dialogues: played in parallel, for each of the targets.
        public_dialogues: in parallel, beside the public simulator.
        plays: times that dialogues are played; the median counts.
        capacity: transitions in the buffer of one network.
        many: replicas side by side.
        many_capacity: transitions in the buffer of each of them.
        repeats: learning phases of each agent.
        bare_updates: of the yardstick in a block.
        rounds: of the accounts, after one to warm up.
        run_rounds: of a whole run, to which the accounts are extrapolated.
        memory_replicas: of the run whose memory is measured.
        memory_rounds: of that run.
        spike: dialogues that fill its buffers.
        eval_dialogues: of its evaluation, and of the measured one.
        learning_seeds: trainings of each agent, until it has learned.
        learning_rounds: of each of these at most.
        learning_overrides: of the configuration of these.
        imports: whether the sub-packages' import times are measured too.
        overrides: of every configuration.
    """

    dialogues: tuple[int, int, int] = (50, 1_000, 16_384)
    public_dialogues: int = 1_000
    plays: int = 5
    capacity: int = 10_000
    many: int = 10
    many_capacity: int = 3_200
    repeats: int = 5
    bare_updates: int = 300
    rounds: int = 3
    run_rounds: int = 400
    memory_replicas: int = 5
    memory_rounds: int = 3
    spike: int = 500
    eval_dialogues: int = 10_000
    learning_seeds: int = 5
    learning_rounds: int = 100
    learning_overrides: tuple[str, ...] = ()
    imports: bool = True
    overrides: tuple[str, ...] = ()


FULL = Sizes()

TINY = Sizes(
    dialogues=(2, 3, 4),
    public_dialogues=3,
    plays=1,
    capacity=TINY_CAPACITY,
    many=2,
    many_capacity=TINY_CAPACITY,
    repeats=1,
    bare_updates=3,
    rounds=1,
    memory_replicas=2,
    memory_rounds=1,
    spike=2,
    eval_dialogues=8,
    learning_seeds=1,
    learning_rounds=3,
    learning_overrides=(
        "protocol.rounds=2",
        "protocol.eval_every=1",
        "protocol.eval_every_dialogues=4",
        "spike.dialogues=4",
    ),
    imports=False,
    overrides=TINY_OVERRIDES,
)
"""Runs every line in seconds; its figures mean nothing."""
