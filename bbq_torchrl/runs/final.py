"""The final evaluation of a run: the agent's, and that of policies that do not learn."""

from __future__ import annotations

import logging
import platform
import time
from importlib.metadata import version
from typing import TYPE_CHECKING

import bbq_torchrl
from bbq_torchrl.domains.validate import RANDOM_POLICY
from bbq_torchrl.evaluation.metrics import read_metrics
from bbq_torchrl.evaluation.results import (
    RunResult,
    TrainingEvaluation,
    replica_result,
    training_evaluation,
)
from bbq_torchrl.evaluation.rollouts import evaluate
from bbq_torchrl.options.values import replica_values
from bbq_torchrl.trainers import NonFiniteWeightsError, RunFolderGoneError
from bbq_torchrl.trainers.hooks import enter_round

if TYPE_CHECKING:
    from pathlib import Path

    from tensordict.nn import TensorDictModuleBase
    from torchrl.envs import EnvBase

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options import Config
    from bbq_torchrl.runs.build import Agent
    from bbq_torchrl.runs.checkout import Checkout
    from bbq_torchrl.trainers import EpisodeStats, RoundTrainer

_LOG = logging.getLogger(__name__)

OTHERS_DIALOGUES = 1_000
"""Dialogues of each policy that the agent is set beside: all of them take a second."""


def final_result(
    config: Config,
    folder: Path,
    domain: Domain | None,
    agent: Agent,
    trainer: RoundTrainer,
    trained: float,
    code: Checkout,
) -> RunResult:
    """Plays the final evaluation, in the state of the domain in which training ended.

    Args:
        config: of the run.
        folder: of the run, with the metrics of the training.
        domain: what it was about.
        agent: what has learned.
        trainer: what trained it.
        trained: seconds of the training.
        code: what has trained it.
    """
    started = time.perf_counter()
    protocol = config.protocol
    places = protocol.places(protocol.eval_dialogues, config.replicas)
    env = _last_env(config, domain, config.replicas, places)
    name, policy = config.agent.make_evaluation(agent.actor)
    NonFiniteWeightsError.check(policy, folder)
    played = _played(config, env, policy, protocol.eval_dialogues)
    RunFolderGoneError.check(folder)
    metrics = read_metrics(folder)
    training_success = metrics.training_success
    evaluated: list[TrainingEvaluation | None] = [None] * config.replicas
    if trainer.evaluator is not None:
        rates = metrics["eval_success_rate"]
        best = trainer.evaluator.best
        evaluated = [
            training_evaluation(rates[:, replica], float(rate), int(number))
            for replica, (rate, number) in enumerate(
                zip(best.success_rate.tolist(), best.round.tolist(), strict=True)
            )
        ]
    values = replica_values(config)
    per_replica = [
        replica_result(
            replica,
            played.success[replica].tolist(),
            played.reward[replica].tolist(),
            played.turns[replica].tolist(),
            float(training_success[replica]),
            values[replica],
            evaluated[replica],
        )
        for replica in range(config.replicas)
    ]
    return RunResult.of(
        per_replica,
        agent=config.agent.name,
        explore=config.explore.name,
        intrinsic=config.intrinsic.name,
        env=config.env.name,
        domain="" if domain is None else domain.name,
        policy=name,
        seed=config.seed,
        rounds=protocol.rounds,
        wall_seconds=trained + time.perf_counter() - started,
        versions=_versions(),
        commit=code.commit,
        clean=code.clean,
        skipped=() if domain is None else domain.skipped,
        **_others(config, domain),
    )


def _others(config: Config, domain: Domain | None) -> dict[str, dict[str, float]]:
    """Returns success rates of policies that do not learn, as :class:`RunResult` has them.

    In the state of the domain in which training ended.
    """
    dialogues = min(config.protocol.eval_dialogues, OTHERS_DIALOGUES)
    env = _last_env(config, domain, 1, dialogues)

    def rates(*names: str) -> dict[str, float]:
        found = {}
        for name in names:
            try:
                policy = config.env.make_policy(name, env)
            except ValueError as error:  # a script that needs a slot which has not come yet
                _LOG.warning("left out of the result: %s", error)
                continue
            played = _played(config, env, policy, dialogues)
            found[name] = played.success.double().mean().item()
        return found

    return {
        "scripted": rates(*config.env.policies(domain), RANDOM_POLICY),
        "references": rates(*config.env.references(domain)),
    }


def _last_env(config: Config, domain: Domain | None, replicas: int, places: int) -> EnvBase:
    """Makes the environment as it was in the last round of the training."""
    env = config.env.make(domain, (replicas, places), device=config.device)
    enter_round(env, max(config.protocol.rounds - 1, 0))
    return env


def _played(
    config: Config, env: EnvBase, policy: TensorDictModuleBase, dialogues: int
) -> EpisodeStats:
    return evaluate(env, policy, dialogues, seed=config.seed, max_steps=config.env.steps())


def _versions() -> dict[str, str]:
    packages = ("torch", "torchrl", "tensordict")
    return {
        "bbq-torchrl": bbq_torchrl.__version__,
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
