"""The end of a run: final evaluation, comparison with other policies, and the curve."""

from __future__ import annotations

import dataclasses
import logging
import platform
import time
from importlib.metadata import version
from pathlib import Path

from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.modules import QValueActor

import bbq_torchrl
from bbq_torchrl.domains import Domain
from bbq_torchrl.domains.domain import RANDOM_POLICY
from bbq_torchrl.evaluation.curves import Metrics
from bbq_torchrl.evaluation.figures import draw_run
from bbq_torchrl.evaluation.finished_runs import agent_name, replicas_of
from bbq_torchrl.evaluation.groups import grouped, read_groups
from bbq_torchrl.evaluation.run_result import (
    RunResult,
    TrainingEvaluation,
    best_script,
    flat_numbers,
    reference_lines,
    replica_result,
    training_evaluation,
    write_json,
)
from bbq_torchrl.options import Config
from bbq_torchrl.options.logger import RunLogger
from bbq_torchrl.options.task import replica_values
from bbq_torchrl.protocols import enter_round
from bbq_torchrl.runs.build import Checkout, check_weights, divergence
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import EpisodeStats, RoundTrainer, RunFolderGoneError, evaluate
from bbq_torchrl.utils.files import CURVE, RESULT

_LOG = logging.getLogger(__name__)

OTHERS_DIALOGUES = 1_000
"""Dialogues of each policy that the agent is compared with; all of them take a second."""


def final_result(
    config: Config,
    folder: Path,
    domain: Domain | None,
    actor: QValueActor,
    trainer: RoundTrainer,
    code: Checkout,
) -> RunResult:
    """Plays the final evaluation with the slots that were active at the end, and writes the result.

    Args:
        config: the run's configuration.
        folder: the run folder.
        domain: the run's domain.
        actor: the trained actor.
        trainer: its trainer, with the metrics of the training.
        code: the state of the code at the start of the run.
    """
    started, rows = time.perf_counter(), trainer.metrics.rows
    trained = sum(row["seconds"] for row in rows if row["replica"] == 0)
    protocol = config.protocol
    _LOG.info("evaluating on %d dialogues a replica", protocol.eval_dialogues)
    parallel = protocol.parallel_dialogues(protocol.eval_dialogues, config.replicas)
    env = _last_env(config, domain, config.replicas, parallel)
    name, policy = config.agent.make_evaluation(actor)
    check_weights(policy, folder)
    played = _played(config, env, policy, protocol.eval_dialogues)
    RunFolderGoneError.check(folder)
    metrics, values = Metrics(rows), replica_values(config)
    evaluated: list[TrainingEvaluation | None] = [None] * config.replicas
    if trainer.evaluator is not None:
        rates, best = metrics["eval_success_rate"].T, trainer.evaluator.best
        bests = best.success_rate.tolist(), best.round.tolist()
        evaluated = [training_evaluation(*found) for found in zip(rates, *bests, strict=True)]
    per_replica = [
        replica_result(
            replica,
            played.success[replica].tolist(),
            played.reward[replica].tolist(),
            played.turns[replica].tolist(),
            *others,
        )
        for replica, others in enumerate(
            zip(metrics.training_success.tolist(), values, evaluated, strict=True)
        )
    ]
    result = RunResult.of(
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
        versions={
            "bbq-torchrl": bbq_torchrl.__version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("torch", "torchrl", "tensordict")},
        },
        commit=code.commit,
        clean=code.clean,
        diverged=tuple(sorted(trainer.learner.diverged)),
        skipped=() if domain is None else domain.skipped,
        warnings=(*divergence(config, rows).values(),),
        **_others(config, domain),
    )
    write_json(result, folder / RESULT)
    return result


def draw_curve(
    config: Config,
    folder: Path,
    result: RunResult,
    trainer: RoundTrainer,
    domain: Domain | None,
    spike_policy: str | None,
) -> None:
    """Draws the learning curve from the metrics in memory, or in the folder of a finished run."""
    rows, plain = trainer.metrics.rows, dataclasses.asdict(config)
    try:
        groups = (
            grouped(replicas_of(folder, plain, result, Metrics(rows)))
            if rows
            else read_groups([folder])
        )
    except ValueError as error:
        raise ConfigError(f"the curve cannot be drawn: {error}") from error
    named = {"explore": result.explore, "env": result.env, "domain": result.domain}
    draw_run(
        folder / CURVE,
        groups,
        title="Success: " + ", ".join(f"{key}={name}" for key, name in named.items() if name),
        spiked=None
        if spike_policy is None
        else f"spiked with {config.spike.dialogues} {spike_policy} dialogues",
        extensions=config.env.additions(domain),
        references=reference_lines(result.scripted, result.references),
    )


def _others(config: Config, domain: Domain | None) -> dict[str, dict[str, float]]:
    """Returns success rates of scripted and privileged policies, as in :class:`RunResult`."""
    dialogues = min(config.protocol.eval_dialogues, OTHERS_DIALOGUES)
    env = _last_env(config, domain, 1, dialogues)

    def rates(*names: str) -> dict[str, float]:
        found = {}
        for name in names:
            try:
                policy = config.env.make_policy(name, env)
            except ValueError as error:  # it needs a slot that was never added
                _LOG.warning("left out of the result: %s", error)
                continue
            played = _played(config, env, policy, dialogues)
            found[name] = played.success.double().mean().item()
        return found

    return {
        "scripted": rates(*config.env.policies(domain), RANDOM_POLICY),
        "references": rates(*config.env.references(domain)),
    }


def _last_env(config: Config, domain: Domain | None, replicas: int, parallel: int) -> EnvBase:
    """Makes the environment of the last training round."""
    env = config.env.make(domain, (replicas, parallel), device=config.device)
    enter_round(env, max(config.protocol.rounds - 1, 0))
    return env


def _played(
    config: Config, env: EnvBase, policy: TensorDictModuleBase, dialogues: int
) -> EpisodeStats:
    return evaluate(env, policy, dialogues, seed=config.seed, max_steps=config.env.steps())


def log_result(config: Config, result: RunResult, logger: RunLogger) -> None:
    """Logs the final success next to that of the best script and of privileged policies."""
    _LOG.info("%s", _result_line(config, result))
    numbers = {f"result/{name}": value for name, value in flat_numbers(result).items()}
    logger.log_result(numbers, result.rounds)


def _result_line(config: Config, result: RunResult) -> str:
    left = [item for item in result.per_replica if item.replica not in result.diverged]
    rates = [item.success_rate for item in left]
    several = f", {_short(min(rates))} to {_short(max(rates))} over {len(rates)} replicas"
    best = best_script(result.scripted)
    others = [f"the best script, {best}, {_short(result.scripted[best])}"] if best else []
    for name, rate in result.references.items():
        others.append(f"{name}, which reads the hidden goal, {_short(rate)}")
    name = agent_name(dataclasses.asdict(config))
    does = "books {} of dialogues" if config.env.has_domain else "succeeds in {} of episodes"
    spread = several if len(rates) > 1 else ""
    return "; ".join([f"{name} {does.format(_short(result.success_rate))}{spread}", *others])


def _short(rate: float) -> str:
    """Returns a rate with two decimals and no leading zero, such as ``.64``, or ``0`` or ``1``."""
    return f"{rate:.2f}".lstrip("0") if 0.005 <= rate < 0.995 else f"{rate:.0f}"
