"""``bbq train``, and ``python train.py`` in a checkout: configuration in, result out.

Everything is checked before Hydra runs anything (:mod:`bbq_torchrl.runs.preparation`). A single run
is then run as it was composed and checked; only the jobs of a sweep, which may start on another
machine, are composed again by Hydra.
"""

from __future__ import annotations

import logging
import os
import re
import shlex
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import env_override
from hydra.errors import CompactHydraException, HydraException

from bbq_torchrl import interruption, output
from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import conf_folder
from bbq_torchrl.options.settings import ConfigError
from bbq_torchrl.run_folder import CONFIG
from bbq_torchrl.runs.compose import to_config
from bbq_torchrl.runs.folders import quoted
from bbq_torchrl.runs.overrides import explain, train_command
from bbq_torchrl.runs.preparation import SingleRun, prepare
from bbq_torchrl.runs.resume import is_finished, restarted_config
from bbq_torchrl.runs.sweeps import FULL_ERROR, tell_no_job
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from omegaconf import DictConfig

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.runs.sweeps import Sweep

_LOG = logging.getLogger(__name__)

REFUSED = 2
"""Exit code of a command that was refused; a run that an error stops ends with 1, Hydra's code."""


class UsageError(CompactHydraException):
    """A job that stopped for a reason that its text says; Hydra prints it without a traceback."""


class _Stopped(BaseException):
    """Carries what stopped a run past Hydra, which would add to what it says."""


def main() -> None:
    """Trains, evaluates, and writes the run folder: one, or those of a sweep."""
    arguments = sys.argv[1:]
    output.escape()  # what is logged
    sweep = None
    with ExitStack() as held:
        try:
            prepared = prepare(arguments, held)
        except (ValueError, OSError) as error:
            _refuse(error)
        logging.raiseExceptions = False  # a full disk is told once, not for every message
        try:
            if isinstance(prepared, SingleRun):
                prepared.start(_single)
                return
            sweep = prepared
            if sweep is not None:
                sys.argv.append(f"hydra.sweep.dir={quoted(sweep.folder)}")
            # Hydra is to raise its errors, not to print them with a traceback.
            with sweep.interruptible() if sweep else env_override({FULL_ERROR: "1"}):
                hydra.main(
                    version_base="1.3", config_path=str(conf_folder()), config_name="config"
                )(_job_of_a_sweep)()
            if sweep is not None:
                sweep.show()
        except BaseException as end:
            _end(end, sweep, arguments)
        finally:
            sys.argv[1:] = arguments
            output.settle()


def _train(config: Config, folder: Path, domain: Domain | None) -> float:
    """Returns the final success rate, which is what sweepers get."""
    from bbq_torchrl.runs import train  # torch and torchrl take ten seconds

    return train.run(config, folder, domain=domain).success_rate


def _job_of_a_sweep(composed: DictConfig) -> float:
    from bbq_torchrl.evaluation.results import read_result

    folder = _told_folder()
    try:
        config = to_config(composed, Config)
        output.escape()
        interruption.listen()
        interruption.end_with_parent()
        interruption.check()
        config = restarted_config(config, folder)
        if is_finished(folder, config.protocol.rounds):
            return read_result(folder).success_rate
        return _train(config, folder, None)
    except interruption.Interrupted:
        tell_no_job()
        raise UsageError(interruption.line()) from None  # the other jobs end in good order
    except Exception as error:
        # Hydra reports the first job that fails, at the end; the log has each.
        _LOG.error("this run failed: %s", sentence(error) or type(error).__name__)
        raise _failure(error) from error


def _single(run: SingleRun) -> float:
    try:
        return _train(run.config, _told_folder(), run.domain)
    except Exception as error:
        raise _Stopped(_failure(error)) from error


def _failure(error: Exception) -> Exception:
    """Returns the error; one whose text is enough for a person is told without a traceback."""
    from bbq_torchrl.trainers import TrainingError

    is_memory = isinstance(error, RuntimeError) and "allocate" in str(error)
    tells = isinstance(error, (ConfigError, OSError, MemoryError, TrainingError)) or is_memory
    return UsageError(sentence(error)) if tells else error


def _told_folder() -> Path:
    """The folder of the run that Hydra has begun; a signal will say how to go on in it."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    interruption.tell(how_to_go_on=lambda: _how_to_go_on(folder))
    return folder


def _how_to_go_on(folder: Path) -> str:
    if not (folder / CONFIG).is_file():
        return "the same command begins again"
    plain = re.fullmatch(r"[\w./~@%+:-]+", os.fspath(folder)) is not None
    override = f"resume={folder if plain else quoted(folder)}"
    return f"{shlex.join([*train_command(), override])} goes on"


def _wants_traceback() -> bool:
    return os.environ.get(FULL_ERROR) == "1"


def _end(end: BaseException, sweep: Sweep | None, arguments: Sequence[str]) -> NoReturn:
    """Ends the command by a sentence where there is one."""
    if code := interruption.exit_code():
        if sweep is not None:
            interruption.tell(lambda: "in a sweep", sweep.how_to_go_on)
        output.complain(interruption.line())
        sys.exit(code)
    if isinstance(end, _Stopped):
        failure = end.args[0]
        if _wants_traceback() or not isinstance(failure, UsageError):
            raise failure from failure.__cause__
        output.complain(f"error: {failure}")
        sys.exit(1)
    if sweep is not None:
        sweep.show()
    elif isinstance(end, Exception) and not _wants_traceback():
        output.complain(f"error: {_of_hydra(end, arguments)}")
        sys.exit(REFUSED)
    raise end


def _of_hydra(error: Exception, arguments: Sequence[str]) -> str:
    """A sentence for what stopped Hydra before the run began."""
    if isinstance(error, HydraException):
        return explain(error, arguments)
    causes = [said for cause in (error, error.__cause__) if cause and (said := sentence(cause))]
    return f"Hydra cannot begin the run: {': '.join(causes) or type(error).__name__}"


def _refuse(error: Exception) -> NoReturn:
    if _wants_traceback():
        raise error
    output.complain(f"error: {sentence(error)}")
    sys.exit(REFUSED)
