"""A command line as ``train.py`` prepares it."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import pytest

from bbq_torchrl.runs import checks, job, sweeps, train
from bbq_torchrl.runs.compose import compose_raw, session
from bbq_torchrl.runs.resume import Resumption

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from bbq_torchrl.options import Config
    from bbq_torchrl.runs.sweeps import Sweep


class _SweepBegins(BaseException):
    """Ends the command before the first job of a sweep."""


def prepare(
    arguments: Sequence[str], check: Callable[[Config], object] = lambda config: None
) -> SimpleNamespace | Sweep | None:
    """The request of a command line: a run as composed, a sweep, or None where Hydra shows.

    The command is that of a person who wants tracebacks: a refusal is an exception.
    """
    begun: list[Any] = [None]

    def checked(config: Config) -> checks.Checked:
        check(config)
        return checks.Checked(config, None, None)

    def start(composed: Any, run: Any) -> float:
        begun.append(SimpleNamespace(composed=job.HydraConfig.instance().cfg))
        return 0.0

    def no_job(sweep: Sweep) -> None:
        begun.append(sweep)
        raise _SweepBegins

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checks, "check", checked)
        patch.setattr(train, "job", start)
        patch.setattr(sweeps.Sweep, "interruptible", no_job)
        patch.setattr(sweeps.Sweep, "show", Mock())
        patch.setattr(job.HydraConfig.instance(), "cfg", None)  # what is shown leaves it behind
        patch.setattr(sys, "argv", ["train.py", *arguments])
        patch.setenv(sweeps.FULL_ERROR, "1")
        try:
            train.main()
        except _SweepBegins:
            pass
        except SystemExit as end:
            if end.code:
                raise
    return begun[-1]


def resumed(folder: Path, *overrides: str) -> Config:
    """The configuration that ``train.py resume=<folder>`` trains with."""
    with ExitStack() as held:
        found = Resumption.of([f"resume={folder}", *overrides], held)
        assert found is not None
        with session():
            return found.config(compose_raw(found.arguments()))
