"""A whole run: training, final evaluation, and what its folder then holds."""

from __future__ import annotations

import dataclasses
import logging
import os
from typing import TYPE_CHECKING

import torch

from bbq_torchrl import interruption
from bbq_torchrl.domains.validate import RANDOM_POLICY
from bbq_torchrl.evaluation.figures import draw_run
from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.evaluation.names import agent_name
from bbq_torchrl.evaluation.results import (
    RunResult,
    flat_numbers,
    reference_lines,
    write_json,
)
from bbq_torchrl.options import ConfigError
from bbq_torchrl.run_folder import CONFIG, CURVE, RESULT
from bbq_torchrl.runs.build import (
    build_trainer,
    make_domain,
    opened_loggers,
    spike_policy,
)
from bbq_torchrl.runs.checkout import checkout
from bbq_torchrl.runs.final import final_result
from bbq_torchrl.runs.folders import run_lock
from bbq_torchrl.runs.resume import result_of, save_config
from bbq_torchrl.trainers import keep_freed_memory

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from torchrl.record.loggers import Logger

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options import Config
    from bbq_torchrl.trainers.hooks import RoundCallback

_LOG = logging.getLogger(__name__)


def run(
    config: Config,
    folder: Path,
    callbacks: Sequence[RoundCallback] = (),
    *,
    domain: Domain | None = None,
) -> RunResult:
    """Trains, evaluates and writes configuration, metrics, result, curve and checkpoints.

    The folder is locked meanwhile.

    Args:
        config: what to run; with ``resume``, the run in the folder goes on.
        folder: the run folder.
        callbacks: called after every round; what one raises ends the run.
        domain: the configuration's, loaded; None: it is loaded here.

    Raises:
        NonFiniteLossError: a loss is NaN or infinite.
        RunFolderGoneError: the folder was moved or removed meanwhile.
        CheckpointDamagedError: a run to resume has no checkpoint any more that can be read.
        CheckpointMismatchError: its checkpoint is of another seed or configuration.
        ConfigError: another process is at work in the folder.
        Interrupted: a signal came (see :mod:`bbq_torchrl.interruption`); all rounds are saved.
    """
    with run_lock(folder), opened_loggers(config, folder) as loggers:
        result = _run(config, folder, callbacks, domain, loggers)
        numbers = {f"result/{name}": value for name, value in flat_numbers(result).items()}
        config.logger.log_result(loggers, numbers, rounds=result.rounds)
    return result


def _run(
    config: Config,
    folder: Path,
    callbacks: Sequence[RoundCallback],
    domain: Domain | None,
    loggers: Sequence[Logger],
) -> RunResult:
    rounds, code = config.protocol.rounds, checkout()  # now: it may change while the run trains
    torch.set_num_threads(config.threads)
    keep_freed_memory()
    _quieten_torchrl()
    save_config(dataclasses.replace(config, resume=None), folder / CONFIG)
    domain = make_domain(config) if domain is None else domain
    spiking = spike_policy(config, domain) if config.spike.dialogues else None
    trainer, agent = build_trainer(
        config, folder, callbacks, domain=domain, spiking=spiking, loggers=loggers
    )
    # There is one where the run was killed before its last file, the curve.
    result = None if config.resume is None else result_of(folder, rounds)
    if result is None:
        interruption.tell(
            lambda: f"after {trainer.rounds_done} of {rounds} rounds, {trainer.rounds_saved} saved"
        )
        _tell_of_evaluations(config)
        if domain is not None:
            _tell_of_domain(domain, config.env.never(domain))
        if spiking is not None and config.spike.policy is None and config.resume is None:
            _LOG.info("spiking with the policy %s, the first that succeeds", spiking)
        with interruption.gently(trainer.stop):
            rows = trainer.train(resume=config.resume is not None)
        interruption.check()
        trained = sum(row["seconds"] for row in rows if row["replica"] == 0)
        _LOG.info("evaluating on %d dialogues a replica", config.protocol.eval_dialogues)
        result = final_result(config, folder, domain, agent, trainer, trained, code)
        write_json(result, folder / RESULT)
    if config.protocol.keep_checkpoints == "weights":
        trainer.checkpoints.keep_only("loss", "best")
    _draw(config, folder, result, domain, spiking)  # last: the run is finished
    _LOG.info("%s", _result_line(config, result))
    _LOG.info("success rate %.4f; everything is in %s", result.success_rate, folder)
    return result


def _tell_of_evaluations(config: Config) -> None:
    """Says so where there will be no evaluation while training."""
    protocol = config.protocol
    if not protocol.eval_every:
        _LOG.info("no evaluation while training: protocol.eval_every is 0")
    elif protocol.eval_every > protocol.rounds:
        _LOG.info(
            "no evaluation while training: protocol.eval_every (%d) is more than "
            "protocol.rounds (%d)",
            protocol.eval_every,
            protocol.rounds,
        )


def _tell_of_domain(domain: Domain, never: set[str]) -> None:
    """Says what of the corpus is not played, or looks odd; some slots, it may be, in no round."""
    for text in domain.skipped:
        _LOG.warning("left out of the domain %s: %s", domain.name, text)
    for text in domain.doubts:
        _LOG.warning("in the domain %s: %s", domain.name, text)
    cut = sum(bool(never & {*goal.constraints, *goal.requests}) for goal in domain.goals)
    if cut:
        named = {slot for goal in domain.goals for slot in (*goal.constraints, *goal.requests)}
        _LOG.info(
            "domain extension never activates %s: %d of %d goals are without them",
            ", ".join(sorted(never & named)),
            cut,
            len(domain.goals),
        )


def _result_line(config: Config, result: RunResult) -> str:
    """Returns the agent's success beside that of the scripted policies and of the privileged ones.

    The best script is named first: an agent that does not reach it was not worth the training.
    """
    rates = [item.success_rate for item in result.per_replica]
    spread = (
        f", {_short(min(rates))} to {_short(max(rates))} over {len(rates)} replicas"
        if len(rates) > 1
        else ""
    )
    scripts = [name for name in result.scripted if name != RANDOM_POLICY]
    best = max(scripts, key=lambda name: result.scripted[name], default=None)
    rated = [
        (f"best script {name}" if name == best else name, result.scripted[name])
        for name in sorted(result.scripted, key=lambda name: name != best)
    ] + [(f"privileged {name}", rate) for name, rate in result.references.items()]
    others = ", ".join(f"{name.replace('_', ' ')} {_short(rate)}" for name, rate in rated)
    name = agent_name(dataclasses.asdict(config))
    does = "books {} of dialogues" if config.env.has_domain else "succeeds in {} of episodes"
    return f"{name} {does.format(_short(result.success_rate))}{spread} ({others})"


def _short(rate: float) -> str:
    """Returns a rate with two decimals and no leading zero, such as ``.64``; ``0`` for none."""
    return f"{rate:.2f}".lstrip("0") if 0.005 <= rate < 0.995 else f"{rate:.0f}"


def _quieten_torchrl() -> None:
    """Keeps TorchRL's notices (of every storage that is made, say) out of the output."""
    if "RL_LOGGING_LEVEL" not in os.environ:  # TorchRL's own variable: the user's word counts
        logging.getLogger("torchrl").setLevel(logging.WARNING)


def _draw(
    config: Config, folder: Path, result: RunResult, domain: Domain | None, spiking: str | None
) -> None:
    try:
        groups = read_groups([folder])
    except ValueError as error:
        raise ConfigError(f"the curve cannot be drawn: {error}") from error
    named = {"explore": result.explore, "env": result.env, "domain": result.domain}
    draw_run(
        folder / CURVE,
        groups,
        title="Success: " + ", ".join(f"{key}={name}" for key, name in named.items() if name),
        spiked=None
        if spiking is None
        else f"spiked with {config.spike.dialogues} {spiking} dialogues",
        extensions=config.env.additions(domain),
        references=reference_lines(result.scripted, result.references),
    )
