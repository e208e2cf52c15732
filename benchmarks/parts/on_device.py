"""Checks and times of a device: agreement with the CPU, host synchronizations, seconds."""

from __future__ import annotations

import json
import sys
import tempfile
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from unittest.mock import patch

import torch

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer
from benchmarks.parts import processes
from benchmarks.parts.host_draws import DrawsOnTheHost
from benchmarks.parts.host_waits import drawn_as_on_a_device
from benchmarks.parts.learning import AGENTS, full_trainer
from benchmarks.parts.rows import Row
from benchmarks.parts.simulator import play_simulator
from benchmarks.parts.timing import interleaved, seconds
from benchmarks.parts.yardstick import bare_update

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from bbq_torchrl.trainers import RoundTrainer

ERROR = 1e-3
"""The largest relative difference of a loss in the first rounds from the CPU's."""


class DeviceSizes(NamedTuple):
    """Amounts that are measured.

    Attributes:
        rounds: trained on both devices.
        compared: overrides of that training.
        dialogues: played side by side.
        replicas: networks updated side by side.
        batches: transitions of an update.
        compiled: replicas for which updates are compiled too, at the first batch size.
        updates: in a block.
        repeats: of each block.
        run: overrides of the whole run.
    """

    rounds: int = 3
    compared: tuple[str, ...] = ("agent=bbqn", "protocol=quick", "replicas=2")
    dialogues: tuple[int, ...] = (50, 1_000, 16_384)
    replicas: tuple[int, ...] = (1, 10, 50)
    batches: tuple[int, ...] = (128, 1_024)
    compiled: tuple[int, ...] = (1, 50)
    updates: int = 50
    repeats: int = 3
    run: tuple[str, ...] = ("agent=bbqn", "protocol=quick")


FULL = DeviceSizes()
_TINY_RUN = (
    *("agent=bbqn", "replicas=2", "agent.hidden=[8]", "protocol.dialogues=4", "protocol.rounds=1"),
    *("protocol.epochs=1", "protocol.eval_every=0", "protocol.eval_dialogues=4"),
    "spike.dialogues=4",
)
TINY = DeviceSizes(
    rounds=1,
    compared=_TINY_RUN,
    run=_TINY_RUN,
    dialogues=(3,),
    replicas=(2,),
    batches=(4,),
    compiled=(),
    updates=2,
    repeats=1,
)


def same_training(device: str, sizes: DeviceSizes) -> Iterator[Row]:
    """Trains some rounds on the CPU and on the device with the same random numbers."""
    with drawn_as_on_a_device():
        here, there = (_trained(place, sizes) for place in ("cpu", device))
    for name in ("success_rate", "reward", "turns"):
        played = max(abs(one[name] - other[name]) for one, other in zip(here, there, strict=True))
        yield Row("same", f"{name} of {sizes.rounds} rounds, largest difference", "", played, 0.0)
    loss = max(abs(a["loss"] / b["loss"] - 1) for a, b in zip(there, here, strict=True))
    yield Row("same", f"loss of {sizes.rounds} rounds, largest share of error", "", loss, ERROR)


def _trained(device: str, sizes: DeviceSizes) -> list[dict[str, float]]:
    with tempfile.TemporaryDirectory() as folder:
        trainer, _ = build_trainer(compose([*sizes.compared, f"device={device}"]), Path(folder))
        # A checkpoint maps files into memory, which a dispatch mode cannot follow.
        with DrawsOnTheHost(), patch.object(trainer.checkpoints, "save"):
            trainer.begin()
            return [row for _ in range(sizes.rounds) for row in trainer.train_round()]


def host_waits(device: str, sizes: DeviceSizes) -> Iterator[Row]:
    """Counts how often the host waits for the device, by torch's check."""
    with tempfile.TemporaryDirectory() as folder:
        trainer, _ = build_trainer(compose([*sizes.compared, f"device={device}"]), Path(folder))
        trainer.begin()
        trainer.train_round()
        env = trainer.env
        state = env.reset()
        for what, work in (
            ("a round's updates", lambda: trainer.learner.update_all(1)),
            ("an action and a turn", lambda: env.step(trainer.policy(state))),
        ):
            yield Row("host", f"{what}: host waits for the device", "", _waits(work), 0)


def _waits(work: Callable[[], object]) -> int:
    torch.cuda.set_sync_debug_mode("warn")
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            work()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    return sum("synchronizing" in str(warning.message) for warning in caught)


def turns(device: str, sizes: DeviceSizes) -> Iterator[Row]:
    """Turns per second of the simulator, including features."""
    for dialogues in sizes.dialogues:
        env = DialogueEnv(movie_domain(), batch_size=(dialogues,), seed=0, device=device)
        play = _finished(device, play_simulator(env))
        valid = play()
        took = min(seconds(play) for _ in range(sizes.repeats))
        what = f"simulator, {dialogues:,} dialogues in parallel"
        yield Row("turns", what, "turns/s", valid / took, better="higher")


def updates(device: str, sizes: DeviceSizes) -> Iterator[Row]:
    """Seconds of an update of all replicas, next to bare ones on the same device."""
    for batch in sizes.batches:
        base = _block(device, bare_update(batch, device), sizes.updates)
        for replicas in sizes.replicas:
            for name in ("dqn", "bbqn-map", "bbqn-mc"):
                for compiles in (False, True)[: 1 + (replicas in sizes.compiled)]:
                    if compiles and batch != sizes.batches[0]:
                        continue
                    with tempfile.TemporaryDirectory() as folder:
                        trainer = full_trainer(
                            (*AGENTS[name], f"device={device}", f"protocol.batch_size={batch}"),
                            Path(folder),
                            replicas=replicas,
                            capacity=2 * batch,
                        )
                        update = _update(trainer, compiles=compiles)
                        measured = interleaved(
                            base, _block(device, update, sizes.updates), sizes.repeats
                        )
                    how = ", compiled" if compiles else ""
                    what = f"update of {name}, replicas={replicas}, batches of {batch:,}{how}"
                    yield Row("updates", what, "ms", 1e3 * measured.seconds)
                    yield Row("updates", what, "times a bare update", measured.ratio)


def _update(trainer: RoundTrainer, *, compiles: bool) -> Callable[[], object]:
    """Returns an update on a fixed batch: loss, gradient, step."""
    trainer.learner.learn(0)  # sets the loss's number of data, and computes targets
    batch = trainer.replay.epoch(trainer.learner.batch_size)[0]
    if not compiles:
        return lambda: trainer.learner.update(batch)
    loss = torch.compile(lambda rows: trainer.learner.loss(rows)["loss"], fullgraph=True)

    def compiled() -> None:
        value = loss(batch.transitions)
        trainer.learner.optimizer.zero_grad()
        value.backward()
        trainer.learner.optimizer.step(None)

    return compiled


def _block(device: str, update: Callable[[], object], count: int) -> Callable[[], float]:
    """Returns a block of updates; its unit is an update. Updates a few times before."""
    for _ in range(3):
        update()
    work = _finished(device, lambda: [update() for _ in range(count)])
    return lambda: seconds(work) / count


def _finished(device: str, work: Callable[[], object]) -> Callable[[], object]:
    """Returns the same work, which ends when the device has finished."""
    if torch.device(device).type != "cuda":
        return work

    def finished() -> object:
        torch.cuda.synchronize(device)
        out = work()
        torch.cuda.synchronize(device)
        return out

    return finished


def whole_run(device: str, sizes: DeviceSizes) -> Iterator[Row]:
    """Seconds of a whole run, including start and evaluation, and its success."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        arguments = (*sizes.run, f"device={device}", f"hydra.run.dir={run}")
        used = processes.python("train.py", *arguments)
        result = run / "result.json"
        what = f"python train.py {' '.join(sizes.run)} device={torch.device(device).type}"
        yield Row("run", what, "s", used.wall)
        if result.is_file():
            rate = json.loads(result.read_text(encoding="utf-8"))["success_rate"]
            yield Row("run", what, "booked", rate, better="higher")
        else:
            sys.stderr.write(f"{what} left no result\n")
