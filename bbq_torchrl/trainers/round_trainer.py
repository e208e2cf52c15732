"""The round trainer: spike, then collect, freeze, learn, freeze, learn, round after round."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torchrl.envs import EnvBase

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.protocols import (
    Annealed,
    Resampled,
    SeesSuccess,
    enter_round,
    modules_with,
)
from bbq_torchrl.trainers.checkpoint import (
    CheckpointDamagedError,
    CheckpointFolder,
    TrainingError,
)
from bbq_torchrl.trainers.collect import Spike, collect_dialogues
from bbq_torchrl.trainers.evaluation import RoundEvaluator
from bbq_torchrl.trainers.learn import Learner, seed_phase
from bbq_torchrl.trainers.recording import MetricRow, MetricsFile, RoundProgress
from bbq_torchrl.utils.files import CHECKPOINTS, METRICS
from bbq_torchrl.utils.seeds import derive_seed

_LOG = logging.getLogger(__name__)


class NonFiniteLossError(TrainingError):
    """A replica's loss became NaN or infinite; the training state has been saved."""


class RunFolderGoneError(TrainingError):
    """A run folder was moved or removed during the run."""

    @classmethod
    def check(cls, run_folder: Path) -> None:
        """Raises the error if the folder no longer exists."""
        if not run_folder.is_dir():
            raise cls(
                f"{run_folder} was moved or removed during the run: "
                "resume=<its new path> continues from its last checkpoint"
            )


@dataclass(eq=False)
class RoundTrainer:
    """Trains R replicas in parallel by the paper's protocol, resumable after a kill.

    In a round every replica plays its dialogues in lockstep, stores the transitions, and learns:
    freeze the target, some epochs over the buffer, freeze again, some epochs again (the paper,
    "Experiments"). The trainer depends on the keys of the data only; everything else is passed in
    as objects.

    Each phase of a round has a separate seed, derived from the run's seed and the round
    (:func:`~bbq_torchrl.utils.seeds.derive_seed`). So a run that is killed at any moment and
    resumed ends, on a CPU, with bitwise the same weights and metrics as an uninterrupted one, and a
    replica never shifts another's random numbers.

    :mod:`bbq_torchrl.protocols` lists the optional methods of these objects that the trainer calls.

    Args:
        env: an environment of batch size [replicas, parallel] that writes ``("next", "success")``
            in addition to the usual keys.
        policy: the exploring policy on the environment's TensorDict.
        learner: loss, replay (empty) and optimizer; what happens after the dialogues of a round.
        run_folder: the folder of ``metrics.csv`` and ``checkpoint/``.

    Keyword Args:
        rounds: the number of rounds.
        dialogues: the number of dialogues of each replica in a round. If the environment plays
            fewer in parallel, several rollouts follow each other.
        checkpoint_every: rounds between two checkpoints. Defaults to 10.
        keep_checkpoints: the number of newest checkpoints to keep; None for all. Defaults to 2.
        max_steps: the maximum number of agent turns in a dialogue; a longer one is an error.
            Defaults to 1000.
        seed: the seed that all random numbers derive from. Defaults to 0.
        spike: fills the buffers before the first round.
        evaluator: evaluates the policy at the end of each round. Other metrics and the weights are
            bitwise the same as without it.
        round_metrics: functions read at the start of each round, such as an exploration rate; each
            returns one number or a tensor [replicas]. A name that another column has is an error at
            the end of the first round.
        callbacks: functions called after every round.
        remedy: what to do when learning diverges, for the error message.
        config_fingerprint: the settings that the training depends on, as JSON values by name, saved
            in every checkpoint. Checkpoints with others are rejected.

    Raises:
        ValueError: if the environment does not have the replay's replicas.
    """

    env: EnvBase
    policy: nn.Module
    learner: Learner
    run_folder: Path
    _: KW_ONLY
    rounds: int
    dialogues: int
    checkpoint_every: int = 10
    keep_checkpoints: int | None = 2
    max_steps: int = 1000
    seed: int = 0
    spike: Spike | None = None
    evaluator: RoundEvaluator | None = None
    round_metrics: Mapping[str, Callable[[], float | Tensor]] = field(default_factory=dict)
    callbacks: Sequence[RoundCallback] = ()
    remedy: str = "lower the learning rate"
    config_fingerprint: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        replicas = self.replicas
        if len(self.env.batch_size) != 2 or self.env.batch_size[0] != replicas:
            raise ValueError(
                f"the environment's batch size must be [{replicas}, parallel] for {replicas} "
                f"replicas, got {list(self.env.batch_size)}"
            )
        self.run_folder = Path(self.run_folder)  # it may be a string
        self.config_fingerprint = {
            "seed": self.seed,
            "replicas": replicas,
            **self.config_fingerprint,
        }
        self.rounds_done = self.rounds_saved = 0
        self._stops = False
        self.metrics = MetricsFile(self.run_folder / METRICS, replicas)
        best: dict[str, Any] = {} if self.evaluator is None else {"best": self.evaluator.best}
        self.checkpoints = CheckpointFolder(
            self.run_folder / CHECKPOINTS,
            keep=self.keep_checkpoints,
            loss=self.learner.loss,
            policy=self.policy,
            optimizer=self.learner.optimizer,
            replay=self.replay,
            metrics=self.metrics,
            **best,
        )

    @property
    def replay(self) -> ReplicaReplay:
        """The buffers."""
        return self.learner.replay

    @property
    def replicas(self) -> int:
        """The number of replicas."""
        return self.replay.replicas

    def train(self, *, resume: bool = False) -> list[MetricRow]:
        """Trains to the last round and returns the metrics, a row for every round and replica.

        Args:
            resume: continue from the newest readable checkpoint in the run folder, or from the
                start if the run was killed before it saved one. Defaults to False.

        Raises:
            ValueError: if the run folder contains a run already and ``resume`` is False.
            CheckpointMismatchError: if its checkpoint has another seed or configuration.
            CheckpointDamagedError: if every checkpoint is damaged, or metrics exist without one.
            NonFiniteLossError: if the losses of all replicas have been NaN or infinite. The others
                learn on without such a replica; its state is saved first.
            RunFolderGoneError: if the run folder is moved or removed during training.
        """
        self.begin(resume=resume)
        bar = RoundProgress(self.rounds, done=self.rounds_done, name=self.run_folder.name)
        with closing(bar):
            while self.rounds_done < self.rounds and not self._stops:
                bar.update(self.train_round())
        if self.rounds_saved < self.rounds_done:
            self._save()
        return list(self.metrics.rows)

    def stop(self) -> None:
        """Makes :meth:`train` end after the current round, with a checkpoint."""
        self._stops = True

    def begin(self, *, resume: bool = False) -> None:
        """Prepares the next round by spiking the buffers or resuming; part of :meth:`train`.

        Args:
            resume: as in :meth:`train`, with the same errors.
        """
        self.checkpoints.remove_leftovers()
        if resume:
            rounds = self.checkpoints.restore(self.config_fingerprint)
            if rounds is not None:
                self.rounds_done = self.rounds_saved = rounds
                self.learner.diverged = {
                    int(row["replica"])
                    for row in self.metrics.rows
                    if not math.isfinite(row["loss"])
                }
                return
            if self.metrics.path.exists():
                raise CheckpointDamagedError.gone(self.run_folder)
        elif self.metrics.path.exists() or self.checkpoints.newest() is not None:
            raise ValueError(
                f"the run folder must be new, or be resumed; {self.run_folder} contains a run "
                "already"
            )
        if self.spike is not None:
            self._begin_phase("spike", 0)
            self.spike.fill(self.replay, self.env, max_steps=self.max_steps)
        self._save()

    def train_round(self) -> list[MetricRow]:
        """Plays, learns and records one round; returns its rows. :meth:`train` is a loop over it.

        It saves a checkpoint every ``checkpoint_every`` rounds; :meth:`train` saves the last one.

        Raises:
            NonFiniteLossError: if the losses of all replicas have been NaN or infinite. The others
                learn on without such a replica; its state is saved first.
            RunFolderGoneError: if the run folder no longer exists; nothing is saved.
        """
        columns = self._round(self.rounds_done)
        RunFolderGoneError.check(self.run_folder)
        rows = self.metrics.append(self.rounds_done, columns)
        self.rounds_done += 1
        for callback in self.callbacks:
            callback(self, rows)
        if self.rounds_done % self.checkpoint_every == 0:
            self._save()
        return rows

    # ---------------------------------------------------------------- phases

    def _round(self, round_number: int) -> dict[str, float | Tensor | Sequence[float]]:
        """Plays and learns one round and returns its metrics by name, in column order."""
        started = time.perf_counter()
        # Cloned, because a metric may share memory with a schedule that changes.
        metrics = {
            name: torch.as_tensor(read(), dtype=torch.float64).clone()
            for name, read in self.round_metrics.items()
        }
        collected = self._collect(round_number)
        collected_at = time.perf_counter()
        learned = self._learn(round_number)
        for module in modules_with(self.policy, Annealed):
            module.step(1)  # epsilon, temperature
        learned_at = time.perf_counter()
        evaluated = {} if self.evaluator is None else self.evaluator(round_number)
        ended = time.perf_counter()
        seconds = {
            "seconds": ended - started,
            "seconds_collect": collected_at - started,
            "seconds_learn": learned_at - collected_at,
            **({} if self.evaluator is None else {"seconds_eval": ended - learned_at}),
        }
        counted = {"buffer": self.replay.lengths, "updates": self.learner.sums.updates}
        # A call, not a display, as two metrics of one name are an error.
        return dict(
            dialogues=self.dialogues,
            **collected,
            **evaluated,
            **learned,
            **counted,
            **metrics,
            **seconds,
        )

    def _collect(self, round_number: int) -> dict[str, Tensor]:
        """Plays and stores the round's dialogues, and returns mean statistics, [replicas] each."""
        self._begin_phase("collect", round_number)
        for module in modules_with(self.policy, Resampled):
            module.resample()
        collected = collect_dialogues(
            self.replay, self.env, self.policy, self.dialogues, max_steps=self.max_steps
        )
        for seeing in modules_with(self.policy, SeesSuccess):
            seeing.see_success(collected["success_rate"])
        return collected

    def _learn(self, round_number: int) -> dict[str, list[float]]:
        """Learns and returns the means of the loss's metrics, for each replica."""
        means = self.learner.learn(round_number, self.seed)
        known = self.learner.diverged
        broken = [r for r, x in enumerate(means["loss"]) if r not in known and not math.isfinite(x)]
        if broken:
            saved = self._save(name=f"failed-round-{round_number:06d}")
            noun = "replica" if len(broken) == 1 else "replicas"
            told = (
                f"the loss of {noun} {', '.join(map(str, broken))} is not finite in round "
                f"{round_number}: {self.remedy}; the state is saved in {saved}"
            )
            self.learner.diverged |= {*broken}
            if len(self.learner.diverged) == self.replicas:
                raise NonFiniteLossError(told)
            _LOG.warning("%s. The other replicas go on, reports leave this out", told)
            with torch.no_grad():
                for parameter in self.learner.loss.parameters():
                    parameter[broken] = 0.0  # it must still act
        return means

    def _begin_phase(self, name: str, round_number: int) -> None:
        """Seeds a phase of dialogues and puts the environment into the round."""
        seed_phase(self.seed, self.replay, name, round_number)
        self.env.set_seed(derive_seed(self.seed, "env", name, round_number))
        enter_round(self.env, round_number)

    def _save(self, *, name: str | None = None) -> Path:
        if self.rounds_done or name is not None:  # the first checkpoint creates the folder
            RunFolderGoneError.check(self.run_folder)
        try:
            saved = self.checkpoints.save(self.rounds_done, self.config_fingerprint, name=name)
        except OSError:
            RunFolderGoneError.check(self.run_folder)  # moved meanwhile
            raise
        if name is None:
            self.rounds_saved = self.rounds_done
        return saved


RoundCallback = Callable[[RoundTrainer, "Sequence[MetricRow]"], None]
"""A function called after every round with the trainer and the round's rows."""
