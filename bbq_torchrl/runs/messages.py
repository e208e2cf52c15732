"""Log messages of a run: start, progress and result."""

from __future__ import annotations

import dataclasses
import logging
from typing import TYPE_CHECKING

from bbq_torchrl.evaluation.finished_runs import agent_name
from bbq_torchrl.evaluation.run_result import best_script

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.evaluation.run_result import RunResult
    from bbq_torchrl.options import Config
    from bbq_torchrl.trainers import RoundTrainer

_LOG = logging.getLogger(__name__)


def log_start(config: Config, domain: Domain | None, spiking: str | None) -> None:
    """Logs missing evaluations, remarks on the domain, and the policy of the spike."""
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
    if domain is not None:
        _log_domain(domain, config.env.inactive_slots(domain))
    if spiking is not None and config.spike.policy is None and config.resume is None:
        why = "the domain's best" if config.spike.takes_best else "the first that succeeds"
        _LOG.info("spiking with the policy %s, %s", spiking, why)


def progress(trainer: RoundTrainer) -> str:
    """Returns the progress of a training, such as ``after 3 of 40 rounds, 3 saved``."""
    return f"after {trainer.rounds_done} of {trainer.rounds} rounds, {trainer.rounds_saved} saved"


def log_result(config: Config, folder: Path, result: RunResult) -> None:
    """Logs the final success next to that of scripted and privileged policies."""
    _LOG.info("%s", _result_line(config, result))
    _LOG.info("success rate %.4f; everything is in %s", result.success_rate, folder)


def _log_domain(domain: Domain, inactive_slots: set[str]) -> None:
    """Logs skipped and doubtful parts of the corpus, and slots that are never active."""
    for text in domain.skipped:
        _LOG.warning("left out of the domain %s: %s", domain.name, text)
    for text in domain.doubts:
        _LOG.warning("in the domain %s: %s", domain.name, text)
    cut = sum(bool(inactive_slots & {*goal.constraints, *goal.requests}) for goal in domain.goals)
    if cut:
        named = {slot for goal in domain.goals for slot in (*goal.constraints, *goal.requests)}
        _LOG.info(
            "domain extension never activates %s: %d of %d goals are without them",
            ", ".join(sorted(inactive_slots & named)),
            cut,
            len(domain.goals),
        )


def _result_line(config: Config, result: RunResult) -> str:
    """Returns the agent's success next to that of scripted (best first) and privileged policies."""
    rates = [item.success_rate for item in result.per_replica]
    spread = (
        f", {_short(min(rates))} to {_short(max(rates))} over {len(rates)} replicas"
        if len(rates) > 1
        else ""
    )
    best = best_script(result.scripted)
    rated = [
        (f"best script {name}" if name == best else name, result.scripted[name])
        for name in sorted(result.scripted, key=lambda name: name != best)
    ] + [(f"privileged {name}", rate) for name, rate in result.references.items()]
    others = ", ".join(f"{name.replace('_', ' ')} {_short(rate)}" for name, rate in rated)
    name = agent_name(dataclasses.asdict(config))
    does = "books {} of dialogues" if config.env.has_domain else "succeeds in {} of episodes"
    return f"{name} {does.format(_short(result.success_rate))}{spread} ({others})"


def _short(rate: float) -> str:
    """Returns a rate with two decimals and no leading zero, such as ``.64``, or ``0`` or ``1``."""
    return f"{rate:.2f}".lstrip("0") if 0.005 <= rate < 0.995 else f"{rate:.0f}"
