"""A whole run: training, final evaluation, and what its folder then holds."""

from __future__ import annotations

import dataclasses
import logging
import os
import platform
import time
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np
import torch

import bbq_torchrl
from bbq_torchrl import interruption
from bbq_torchrl.build import build_env, build_trainer
from bbq_torchrl.config.resume import CURVE, RUN_CONFIG
from bbq_torchrl.config.run_lock import run_lock
from bbq_torchrl.config.store import save_config
from bbq_torchrl.config.values import replica_values
from bbq_torchrl.evaluation.figures import Curves, draw_run
from bbq_torchrl.evaluation.names import agent_name
from bbq_torchrl.evaluation.play import evaluate
from bbq_torchrl.evaluation.results import (
    RESULT_FILE,
    RunResult,
    read_metrics,
    read_result,
    replica_result,
    write_json,
)
from bbq_torchrl.trainers import keep_freed_memory

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bbq_torchrl.build import Agent
    from bbq_torchrl.config import Config
    from bbq_torchrl.envs import DialogueEnv
    from bbq_torchrl.trainers.round_trainer import RoundCallback

__all__ = ["run"]

_LOG = logging.getLogger(__name__)


def run(config: Config, folder: Path, callbacks: Sequence[RoundCallback] = ()) -> RunResult:
    """Trains, evaluates and writes configuration, metrics, result, curve and checkpoints.

    The folder is locked meanwhile.

    Args:
        config: what to run; with ``resume``, the run in the folder goes on.
        folder: the run folder.
        callbacks: called after every round; what one raises ends the run.

    Raises:
        NonFiniteLossError: a loss is NaN or infinite.
        CheckpointDamagedError: a run to resume has no checkpoint any more that can be read.
        CheckpointMismatchError: its checkpoint is of another seed or configuration.
        ConfigError: another process is at work in the folder.
        Interrupted: a signal came (see :mod:`bbq_torchrl.interruption`); all rounds are saved.
    """
    with run_lock(folder):
        return _run(config, folder, callbacks)


def _run(config: Config, folder: Path, callbacks: Sequence[RoundCallback]) -> RunResult:
    rounds = config.protocol.rounds
    torch.set_num_threads(config.threads)
    keep_freed_memory()
    _quieten_torchrl()
    save_config(dataclasses.replace(config, resume=None), folder / RUN_CONFIG)
    trainer, agent = build_trainer(config, folder, callbacks)
    result = None if config.resume is None else _result_of(folder, rounds)
    if result is None:
        interruption.tell(
            lambda: f"after {trainer.rounds_done} of {rounds} rounds, {trainer.rounds_saved} saved"
        )
        with interruption.gently(trainer.stop):
            rows = trainer.train(resume=config.resume is not None)
        interruption.check()
        trained = sum(row["seconds"] for row in rows if row["replica"] == 0)
        started = time.perf_counter()
        _LOG.info("evaluating on %d dialogues a replica", config.protocol.eval_dialogues)
        result = _evaluated(config, folder, agent, trainer.env, trained, started)
        write_json(result, folder / RESULT_FILE)
    if config.protocol.keep_checkpoints == "weights":
        trainer.checkpoints.keep_only("loss", "best")
    _draw(config, folder, result, trainer.env)  # last: the run is finished
    _LOG.info("success rate %.4f; everything is in %s", result.success_rate, folder)
    return result


def _result_of(folder: Path, rounds: int) -> RunResult | None:
    """Returns the result of a run that was killed before its last file, the curve."""
    try:
        result = read_result(folder)
    except ValueError:
        return None
    return result if result.rounds == rounds else None


def _quieten_torchrl() -> None:
    """Keeps TorchRL's notices (of every storage that is made, say) out of the output."""
    if "RL_LOGGING_LEVEL" not in os.environ:  # TorchRL's own variable: the user's word counts
        logging.getLogger("torchrl").setLevel(logging.WARNING)


def _evaluated(
    config: Config,
    folder: Path,
    agent: Agent,
    training_env: DialogueEnv,
    trained: float,
    started: float,
) -> RunResult:
    """Plays the final evaluation, in the state of the domain in which training ended."""
    protocol = config.protocol
    env = build_env(
        config.env,
        training_env.domain,
        (config.replicas, min(_evaluation_places(config), protocol.eval_dialogues)),
        device=config.device,
        cuda_graph=config.cuda_graph,
    )
    env.set_round(max(protocol.rounds - 1, 0))
    name, policy = agent.evaluation(None)
    played = evaluate(env, policy, protocol.eval_dialogues, seed=config.seed)
    training_success = read_metrics(folder).training_success
    values = replica_values(config)
    per_replica = [
        replica_result(
            replica,
            played.success[replica].tolist(),
            played.reward[replica].tolist(),
            played.turns[replica].tolist(),
            float(training_success[replica]),
            values[replica],
        )
        for replica in range(config.replicas)
    ]
    return RunResult.of(
        per_replica,
        agent=config.agent.name,
        explore=config.explore.name,
        intrinsic=config.intrinsic.name,
        env=config.env.name,
        domain=config.domain.name,
        policy=name,
        seed=config.seed,
        rounds=protocol.rounds,
        wall_seconds=trained + time.perf_counter() - started,
        versions=_versions(),
    )


def _evaluation_places(config: Config) -> int:
    """Returns how many dialogues of a replica are played side by side.

    A rollout holds every turn's observations: of 12,500 dialogues they fill two gigabytes.
    """
    return max(1, config.protocol.eval_batch // config.replicas)


def _draw(config: Config, folder: Path, result: RunResult, env: DialogueEnv) -> None:
    spike = config.spike
    name = f"{agent_name(dataclasses.asdict(config))}, {config.explore.name}"
    success = read_metrics(folder)["success_rate"]
    final = np.array([item.success_rate for item in result.per_replica])
    together: dict[str, list[int]] = {}
    for replica, values in enumerate(replica_values(config)):
        label = ", ".join([name, *(f"{key}={value:g}" for key, value in values.items())])
        together.setdefault(label, []).append(replica)
    draw_run(
        folder / CURVE,
        [Curves(label, success[:, same], final[same]) for label, same in together.items()],
        title=f"Training success: env={config.env.name}, domain={config.domain.name}",
        spiked=f"spiked with {spike.dialogues} {spike.policy} dialogues"
        if spike.dialogues
        else None,
        extensions={} if env.schedule is None else env.schedule.additions(env.domain),
    )


def _versions() -> dict[str, str]:
    packages = ("torch", "torchrl", "tensordict")
    return {
        "bbq-torchrl": bbq_torchrl.__version__,
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
