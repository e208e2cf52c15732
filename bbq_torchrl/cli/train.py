"""``bbq train``, and ``python train.py`` in a checkout: configuration in, result out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.cli.command import command

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options import Config

__all__ = ["main"]


# The parts are imported when they are needed: torch and torchrl take ten seconds, --help none.
def _check(config: Config) -> Domain | None:
    """Checks device and corpus before anything runs. Returns the domain."""
    from bbq_torchrl.cli import checks

    return checks.check(config)


def _usage_errors() -> tuple[type[Exception], ...]:
    """Returns the errors of a run whose text is enough for a person."""
    from bbq_torchrl.trainers import (
        CheckpointDamagedError,
        CheckpointMismatchError,
        NonFiniteLossError,
        SpikeError,
    )

    return NonFiniteLossError, CheckpointDamagedError, CheckpointMismatchError, SpikeError


@command(_check, _usage_errors)
def main(config: Config, run_folder: Path, domain: Domain | None) -> float:
    """Trains, evaluates, and writes the run folder. Returns the final success rate."""
    from bbq_torchrl.run import run

    return run(config, run_folder, domain=domain).success_rate
