"""Time and memory against rounds, buffer, replicas, dialogues of a round and records.

    OMP_NUM_THREADS=1 python benchmarks/growth.py             everything, under ten minutes
    OMP_NUM_THREADS=1 python benchmarks/growth.py replicas    replaces the last figures
    python benchmarks/growth.py --tiny                        seconds; tests the script itself

Each cell runs in a separate process, whose peak memory is counted without the imported packages,
and is written to results/growth.csv as soon as it is measured.
"""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import random
import resource
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python benchmarks/growth.py` finds its own packages

import torch  # noqa: E402

from bbq_torchrl.domains import Domain, movie_domain  # noqa: E402
from bbq_torchrl.envs import DialogueEnv  # noqa: E402
from bbq_torchrl.runs.compose import compose  # noqa: E402
from bbq_torchrl.runs.train import build_trainer  # noqa: E402
from benchmarks.parts.learning import full_trainer  # noqa: E402
from benchmarks.parts.simulator import play_simulator  # noqa: E402
from benchmarks.parts.timing import cpu_seconds, one_thread, seconds  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

FILE = ROOT / "results" / "growth.csv"
COLUMNS = ("what", "size", "seconds", "megabytes")
BBQN, DQN = ("agent=bbqn",), ("agent=dqn",)
LOCKSTEP = 250
"""Parallel dialogues on a knowledge base."""


def rounds(size: int, run: Path) -> float:
    """Trains DQN for a number of short rounds; measures the training."""
    small = ("protocol.dialogues=2", "protocol.capacity=32", "spike=none", "agent.hidden=[8]")
    # The time of longer dialogues would depend on the learned policy.
    config = compose([*DQN, *small, "env.max_turn=2", f"protocol.rounds={size}"])
    trainer, _ = build_trainer(config, run)
    return seconds(trainer.train)


def buffer(size: int, run: Path) -> float:
    """Learns with BBQN on a full buffer of a number of transitions: a freeze, an epoch."""
    once = (*BBQN, "protocol.freezes=1", "protocol.epochs=1")
    trainer = full_trainer(once, run, replicas=1, capacity=size)
    return seconds(lambda: trainer.learner.learn(0))


def gp(size: int, run: Path) -> float:
    """Fits a sparse Gaussian process to a full buffer of a number of transitions."""
    chosen = ("agent=gp", f"agent.inducing={min(size, 512)}")
    trainer = full_trainer(chosen, run, replicas=1, capacity=size)
    return cpu_seconds(lambda: trainer.learner.learn(0))


def exact_gp(size: int, run: Path) -> float:
    """Fits an exact Gaussian process to as many: one Cholesky and the values of next states."""
    rows = full_trainer(DQN, run, replicas=1, capacity=size).replay.epoch(size)[0].transitions[0]
    states, after = rows["observation"], rows["next", "observation"]

    def fit() -> None:
        gram = torch.cdist(states, states).square_().mul_(-0.05).exp_()
        gram.diagonal().add_(1.0)
        root = torch.linalg.cholesky(gram)
        del gram
        weights = torch.cholesky_solve(rows["next", "reward"], root)
        del root
        torch.cdist(after, states).square_().mul_(-0.05).exp_() @ weights

    return cpu_seconds(fit)


def replicas(size: int, run: Path) -> float:
    """Trains a number of BBQN replicas for a round of 50 dialogues and 40 updates each."""
    trainer = full_trainer(BBQN, run, replicas=size, capacity=320)
    trainer.train_round()
    return seconds(trainer.train_round)


def dialogues(size: int, run: Path) -> float:
    """Plays and stores a number of dialogues of a round with BBQN."""
    trainer, _ = build_trainer(compose([*BBQN, f"protocol.dialogues={size}", "spike=none"]), run)
    trainer._collect(0)
    return min(seconds(lambda: trainer._collect(1)) for _ in range(3))


def records(size: int, _: Path, new_every: int | None = None) -> float:
    """Plays 250 dialogues on a knowledge base of a number of records."""
    domain = varied(movie_domain(), size, new_every=new_every)
    play = play_simulator(DialogueEnv(domain, batch_size=(LOCKSTEP,), seed=0))
    play()
    return min(seconds(play) for _ in range(3))


def records_build(size: int, _: Path) -> float:
    """Makes the environment with that knowledge base."""
    domain = varied(movie_domain(), size)
    return seconds(lambda: DialogueEnv(domain, batch_size=(LOCKSTEP,), seed=0))


def varied(domain: Domain, size: int, *, new_every: int | None = None) -> Domain:
    """Returns the domain with a number of records, mixed from its records.

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


GROWTH: dict[str, tuple[Callable[[int, Path], float], tuple[int, ...]]] = {
    "rounds": (rounds, (30, 100, 300, 1_000)),
    "buffer": (buffer, (1_000, 3_000, 10_000, 30_000, 100_000)),
    "gp": (gp, (1_000, 2_000, 4_000, 8_000, 12_000, 40_000)),
    "exact_gp": (exact_gp, (1_000, 2_000, 4_000, 8_000, 12_000)),
    "replicas": (replicas, (1, 2, 5, 10, 20, 50)),
    "dialogues": (dialogues, (10, 30, 100, 300, 1_000, 3_000)),
    "records": (records, (100, 1_000, 10_000, 100_000)),
    "records_build": (records_build, (100, 1_000, 10_000, 100_000)),
    "new_values": (partial(records, new_every=10), (100, 1_000, 10_000, 30_000)),
}
"""Name -> the function, and its sizes."""


def measure(what: str, size: int) -> tuple[float, float]:
    """Measures one cell in a child process. Returns seconds and megabytes."""
    # A fork has everything imported already, so only the cell itself is counted.
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as child:
        took, peak = child.submit(_cell, what, size).result()
    return round(took, 6), round(peak / 1e6, 3)


def _cell(what: str, size: int) -> tuple[float, int]:
    before = _peak()
    one_thread()
    with tempfile.TemporaryDirectory() as folder:
        took = GROWTH[what][0](size, Path(folder) / "run")
    return took, max(_peak() - before, 1)


def _peak() -> int:
    """Returns the peak memory of this process in bytes."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def keep(file: Path, line: Sequence[object]) -> None:
    """Writes a cell, replacing its earlier measurement, in the order of GROWTH."""
    cells = {}
    if file.is_file():
        with file.open(newline="", encoding="utf-8") as opened:
            cells = {(what, int(size)): rest for what, size, *rest in list(csv.reader(opened))[1:]}
    cells[line[0], line[1]] = line[2:]
    order = sorted(cells, key=lambda cell: (list(GROWTH).index(cell[0]), cell[1]))
    with file.open("w", newline="", encoding="utf-8") as opened:
        csv.writer(opened, lineterminator="\n").writerows(
            [COLUMNS, *((*cell, *cells[cell]) for cell in order)]
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures the cells of the given names, by default all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="*", choices=[*GROWTH, []], help="default: all")
    parser.add_argument("--tiny", action="store_true", help="a size that only tests the script")
    parser.add_argument("--file", type=Path, default=FILE, help="default: results/growth.csv")
    chosen = parser.parse_args(arguments)
    for what in chosen.what or GROWTH:
        for size in (40,) if chosen.tiny else GROWTH[what][1]:
            line = (what, size, *measure(what, size))
            if not chosen.tiny:
                keep(chosen.file, line)
            print(*(f"{name} {value}" for name, value in zip(COLUMNS, line, strict=True)), sep=", ")


if __name__ == "__main__":
    main()
