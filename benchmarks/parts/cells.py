"""What grows: each function does one cell's work and returns the seconds that count."""

from __future__ import annotations

import random
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.training import build_trainer
from bbq_torchrl.domains import Domain, movie_domain
from bbq_torchrl.envs import DialogueEnv
from benchmarks.parts.dialogues import play_simulator
from benchmarks.parts.learning import full_trainer

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.parts.timing import Timer

    Cell = Callable[[int, Timer], float]

BBQN, DQN = ("agent=bbqn",), ("agent=dqn",)
LOCKSTEP = 250
"""Dialogues played side by side on a knowledge base."""


def rounds(size: int, timer: Timer) -> float:
    """Trains DQN for so many rounds of hardly any work; the training is what counts."""
    small = (
        "protocol.dialogues=2",
        "protocol.capacity=32",
        "spike=none",
        "agent.hidden=[8]",
        "env.max_turn=2",  # or rounds would be longer or shorter with what is learned
    )
    with tempfile.TemporaryDirectory() as folder:
        config = compose([*DQN, *small, f"protocol.rounds={size}"])
        trainer, _ = build_trainer(config, Path(folder) / "run")
        trainer.progress = False
        return timer.time(trainer.train)


def buffer(size: int, timer: Timer) -> float:
    """Learns with BBQN on a full buffer of so many transitions: a freeze, an epoch."""
    with tempfile.TemporaryDirectory() as folder:
        trainer = full_trainer(
            (*BBQN, "protocol.freezes=1", "protocol.epochs=1"),
            Path(folder) / "run",
            replicas=1,
            capacity=size,
        )
        return timer.time(lambda: trainer._learn(0))


def replicas(size: int, timer: Timer) -> float:
    """Trains so many BBQNs for a round of 50 dialogues and 40 updates each."""
    with tempfile.TemporaryDirectory() as folder:
        trainer = full_trainer(BBQN, Path(folder) / "run", replicas=size, capacity=320)
        trainer.train_round()
        return timer.time(trainer.train_round)


def dialogues(size: int, timer: Timer) -> float:
    """Plays and stores so many dialogues of a round with BBQN."""
    with tempfile.TemporaryDirectory() as folder:
        config = compose([*BBQN, f"protocol.dialogues={size}", "spike=none"])
        trainer, _ = build_trainer(config, Path(folder) / "run")
        trainer._collect(0)
        return min(timer.time(lambda: trainer._collect(1)) for _ in range(3))


def records(size: int, timer: Timer) -> float:
    """Plays 250 dialogues on a knowledge base of so many records, with the corpus's values."""
    play = play_simulator(_env(varied(movie_domain(), size)))
    play()
    return min(timer.time(play) for _ in range(3))


def records_build(size: int, timer: Timer) -> float:
    """Makes the environment with such a knowledge base."""
    domain = varied(movie_domain(), size)
    return timer.time(lambda: _env(domain))


def new_values(size: int, timer: Timer) -> float:
    """Plays 250 dialogues on a knowledge base of so many records, each tenth with a new value."""
    play = play_simulator(_env(varied(movie_domain(), size, new_every=10)))
    play()
    return min(timer.time(play) for _ in range(3))


def _env(domain: Domain) -> DialogueEnv:
    return DialogueEnv(domain, batch_size=(LOCKSTEP,), seed=0)


def varied(domain: Domain, size: int, *, new_every: int | None = None) -> Domain:
    """Returns the domain with so many records, mixed from its own.

    A record has the slots of one of the domain's records and for each of them the value of some
    other record.

    Args:
        domain: whose records are mixed.
        size: number of records.
        new_every: of so many records, one has a theatre that no other has.
    """
    rng = random.Random(0)
    values: dict[str, list[str]] = {}
    for record in domain.records:
        for slot, value in record.items():
            values.setdefault(slot, []).append(value)
    mixed = []
    for number in range(size):
        record = {slot: rng.choice(values[slot]) for slot in rng.choice(domain.records)}
        if new_every is not None and number % new_every == 0:
            record["theater"] = f"theater number {number}"
        mixed.append(record)
    return replace(domain, records=tuple(mixed))


GROWTH: dict[str, tuple[Cell, tuple[int, ...], str]] = {
    "rounds": (rounds, (30, 100, 300, 1_000), "rounds of a training"),
    "buffer": (buffer, (1_000, 3_000, 10_000, 30_000, 100_000), "transitions in the buffer"),
    "replicas": (replicas, (1, 2, 5, 10, 20, 50), "replicas"),
    "dialogues": (dialogues, (10, 30, 100, 300, 1_000, 3_000), "dialogues of a round"),
    "records": (records, (100, 1_000, 10_000, 100_000), "records, a batch of dialogues"),
    "records_build": (records_build, (100, 1_000, 10_000, 100_000), "records, building"),
    "new_values": (new_values, (100, 1_000, 10_000, 30_000), "records, every tenth a new value"),
}
"""Name -> what is done, how much of it, and what the size counts."""

TINY_SIZES = {
    "rounds": (1, 2),
    "buffer": (40, 80),
    "replicas": (1, 2),
    "dialogues": (2, 4),
    "records": (10, 20),
    "records_build": (10, 20),
    "new_values": (10, 20),
}
