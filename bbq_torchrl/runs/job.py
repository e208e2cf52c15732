"""A training as Hydra's job: invalid input is refused before a folder exists, in one sentence.

Hydra parses the command line, composes, names the folder, logs, sweeps and launches.
:class:`Checks`, the callback in ``conf/config.yaml``, checks the composed configuration first: an
invalid value, combination, device or corpus ends the command with exit code 2, also if it is one of
many jobs of a sweep. Overrides that Hydra cannot compose are checked against the options' schemas
(:mod:`bbq_torchrl.runs.overrides`).
"""

from __future__ import annotations

import logging
import os
import re
import shlex
import sys
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import load_folder, options_folder
from bbq_torchrl.options.store import register_options
from bbq_torchrl.runs.compose import session, to_config, why_refused
from bbq_torchrl.runs.folders import quoted, refuse_other_folder, run_folder
from bbq_torchrl.runs.overrides import (
    not_an_option,
    refuse_second_folder,
    too_large,
    train_command,
    without_sweeps,
)
from bbq_torchrl.runs.resume import Resumption, is_finished, restarted_config
from bbq_torchrl.runs.sweeps import FULL_ERROR, Sweep, prepare_sweep, refuse_unswept, silence_jobs
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.files import CONFIG
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterator, Sequence

    from bbq_torchrl.evaluation.run_result import RunResult
    from bbq_torchrl.runs.checks import Checked

_LOG = logging.getLogger(__name__)

REFUSED = 2
"""Exit code of a refused command; a run stopped by an error has Hydra's code, 1."""


@dataclass
class _Command:
    """State shared by the command, Hydra's callback and the job in one process."""

    locks: ExitStack = field(default_factory=ExitStack)
    resumption: Resumption | None = None
    run: Checked | None = None
    sweep: Sweep | None = None
    wants_traceback: bool = False


_command = _Command()


class UsageError(CompactHydraException):
    """An error whose message suffices; Hydra prints it without a traceback."""


class _Stopped(BaseException):
    """Carries an exception past Hydra, which would print more than its message."""


class Checks(Callback):
    """Checks the configuration that Hydra composed, before a folder exists."""

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Checks a single run, and chooses and locks its folder."""
        with _refusing():
            overrides = _overrides(config)
            _command.run = begin(config, overrides, _command.locks, _command.resumption)

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Checks every job of a sweep, and makes the sweep's folder."""
        with _refusing():
            sweep = prepare_sweep(_overrides(config))
        folder = sweep.folder.absolute()  # workers of a Ray cluster have other working directories
        with read_write(config), open_dict(config):
            config.hydra.sweep.dir = str(folder)
            config.hydra.overrides.hydra.append(f"hydra.sweep.dir={quoted(folder)}")
        if not _command.wants_traceback:
            os.environ.pop(FULL_ERROR, None)  # Hydra reports failures job by job
        _command.sweep = sweep
        _command.locks.enter_context(sweep.interruptible())


def begin(
    composed: DictConfig,
    overrides: Sequence[str],
    locks: ExitStack,
    resumption: Resumption | None = None,
) -> Checked:
    """Checks a single run before anything is written, and gives it a folder.

    Args:
        composed: the configuration with Hydra's part; the name of the folder is set in it.
        overrides: the command line.
        locks: the stack that releases the lock of the folder.
        resumption: the run to resume; None for a new one.

    Raises:
        ConfigError: one sentence that names the fault and the allowed values.
        ValueError or OSError: an unusable corpus.
    """
    if resumption is not None:
        config = resumption.config(composed)
    else:
        if (refusal := not_an_option(overrides, Config)) is not None:
            raise ConfigError(refusal)
        refuse_unswept(composed, overrides)
        config = to_config(composed, Config)
        if config.resume is not None:
            raise ConfigError(
                f"resume must be given on the command line, as resume=<folder>, got {config.resume}"
            )
    refuse_other_folder(overrides, "sweep", "a sweep (--multirun)", "run")
    from bbq_torchrl.runs import checks  # torch and torchrl take ten seconds

    checked = checks.check(config)
    with read_write(composed), open_dict(composed):
        if resumption is None:
            composed.hydra.run.dir = str(run_folder(composed, overrides, locks))
        else:
            composed.hydra.run.dir = str(resumption.folder)
            composed.hydra.output_subdir = None  # as the first process wrote it
    return checked


def job(composed: DictConfig, run: Callable[..., RunResult]) -> float:
    """Runs Hydra's job: a run that :class:`Checks` has prepared, or a job of a sweep.

    Args:
        composed: the configuration.
        run: :func:`bbq_torchrl.runs.train.run`.

    Returns:
        The final success rate, for sweepers.
    """
    folder = Path(HydraConfig.get().runtime.output_dir)
    interruption.tell(how_to_continue=lambda: _how_to_continue(folder))
    checked = _command.run
    if checked is None:
        return _job_of_a_sweep(composed, folder, run)
    try:
        result = run(checked.config, folder, domain=checked.domain, spiking=checked.spiking)
    except Exception as error:
        raise _Stopped(_failure(error)) from error
    return result.success_rate


def _job_of_a_sweep(composed: DictConfig, folder: Path, run: Callable[..., RunResult]) -> float:
    from bbq_torchrl.evaluation.run_result import read_result

    try:
        config = to_config(composed, Config)
        output.escape()
        interruption.listen()
        interruption.end_with_parent()
        interruption.check()
        config = restarted_config(config, folder)
        if is_finished(folder, config.protocol.rounds):
            return read_result(folder).success_rate
        return run(config, folder).success_rate
    except interruption.Interrupted:
        silence_jobs()
        raise UsageError(interruption.line()) from None  # lets the other jobs finish their rounds
    except Exception as error:
        # Hydra reports only the first failing job, at the end; the log has all of them.
        _LOG.error("this run failed: %s", sentence(error) or type(error).__name__)
        raise _failure(error) from error


def command(hydra_main: Callable[[], object]) -> Callable[[], None]:
    """Decorates Hydra's main function: failures end in one sentence and an exit code."""

    @wraps(hydra_main)
    def main() -> None:
        arguments, full_error = sys.argv[1:], os.environ.get(FULL_ERROR)
        output.escape()  # for log messages
        with ExitStack() as locks:
            _command.locks, _command.wants_traceback = locks, full_error == "1"
            _command.resumption = _command.run = _command.sweep = None
            try:
                overrides = _checked_arguments(arguments)
            except (ValueError, OSError) as error:
                _refuse(error)
            logging.raiseExceptions = False  # reports a full disk once, not for every message
            os.environ[FULL_ERROR] = "1"  # makes Hydra raise its errors instead of printing them
            try:
                hydra_main()
                if _command.sweep is not None:
                    _command.sweep.show()
            except BaseException as end:
                _end(end, overrides)
            finally:
                os.environ.pop(FULL_ERROR, None)
                if full_error is not None:
                    os.environ[FULL_ERROR] = full_error
                sys.argv[1:] = arguments
                output.settle()

    return main


def _checked_arguments(arguments: Sequence[str]) -> list[str]:
    """Checks the flags, loads options, and prepares resuming. Returns the overrides.

    For a sweep these are the overrides that all jobs share.

    Raises:
        ConfigError: an unsupported flag, or a run that cannot be resumed.
    """
    parsed = _parsed(arguments)
    refuse_second_folder(arguments)
    if parsed.config_dir is not None:
        load_folder(Path(parsed.config_dir))
    elif (folder := options_folder()) is not None:  # from the environment
        arguments = ["--config-dir", str(folder), *arguments]
        sys.argv[1:] = arguments
    register_options()
    if parsed.help or parsed.hydra_help or parsed.cfg or parsed.info or parsed.shell_completion:
        _command.locks.enter_context(output.collected())
        return list(parsed.overrides)
    for flag in ("config_path", "config_name", "experimental_rerun"):
        if getattr(parsed, flag) is not None:
            name = "--" + flag.replace("_", "-")
            raise ConfigError(f"{name} is not supported: choose by <group>=<option>")
    for flag in ("resolve", "package"):
        if getattr(parsed, flag):
            raise ConfigError(f"--{flag} is for --cfg, which shows a configuration")
    if (refusal := too_large(parsed.overrides)) is not None:
        raise ConfigError(refusal)
    if not parsed.multirun and (found := Resumption.of(parsed.overrides, _command.locks)):
        _command.resumption = found
        flags = [item for item in arguments if item not in parsed.overrides]
        sys.argv[1:] = [*flags, *found.arguments()]
        return found.arguments()
    return without_sweeps(parsed.overrides) if parsed.multirun else list(parsed.overrides)


def _parsed(arguments: Sequence[str]) -> Namespace:
    """Reads Hydra's documented flags as Hydra's parser will."""

    def refuse(message: str) -> NoReturn:
        raise ConfigError(f"{sentence(message)}; see --help")

    parser = output.Parser(add_help=False)
    parser.error = refuse  # type: ignore[method-assign]
    parser.add_argument("overrides", nargs="*")
    for flags in (
        *(("--help", "-h"), ("--hydra-help",), ("--version",), ("--resolve",)),
        *(("--run", "-r"), ("--multirun", "-m"), ("--shell-completion", "-sc")),
    ):
        parser.add_argument(*flags, action="store_true")
    for flags in (
        *(("--package", "-p"), ("--config-path", "-cp"), ("--config-name", "-cn")),
        *(("--config-dir", "-cd"), ("--experimental-rerun",)),
    ):
        parser.add_argument(*flags)
    parser.add_argument("--cfg", "-c", choices=["job", "hydra", "all"])
    kinds = ["all", "config", "defaults", "defaults-tree", "plugins", "searchpath"]
    parser.add_argument("--info", "-i", const="all", nargs="?", choices=kinds)
    return parser.parse_args(list(arguments))


def _overrides(config: DictConfig) -> list[str]:
    given: Any = OmegaConf.to_container(config.hydra.overrides, resolve=False)
    hydra = [item for item in given["hydra"] if not item.startswith("hydra.mode=")]
    return [*given["task"], *hydra]


@contextmanager
def _refusing() -> Iterator[None]:
    """Ends the command if a check fails; Hydra only warns of exceptions in callbacks."""
    try:
        yield
    except Exception as error:
        if _command.wants_traceback or not isinstance(error, (ValueError, OSError)):
            raise _Stopped(error) from error
        _refuse(error)


def _failure(error: Exception) -> Exception:
    """Returns the error, as :class:`UsageError` if its message suffices without a traceback."""
    from bbq_torchrl.trainers import TrainingError

    is_memory = isinstance(error, RuntimeError) and "allocate" in str(error)
    suffices = isinstance(error, (ConfigError, OSError, MemoryError, TrainingError)) or is_memory
    return UsageError(sentence(error)) if suffices else error


def _how_to_continue(folder: Path) -> str:
    if not (folder / CONFIG).is_file():
        return "the same command starts again"
    plain = re.fullmatch(r"[\w./~@%+:-]+", os.fspath(folder)) is not None
    override = f"resume={folder if plain else quoted(folder)}"
    return f"{shlex.join([*train_command(), override])} continues it"


def _end(end: BaseException, overrides: Sequence[str]) -> NoReturn:
    """Ends the command by a sentence if there is one."""
    sweep, wants_traceback = _command.sweep, _command.wants_traceback
    if code := interruption.exit_code():
        if sweep is not None:
            interruption.tell(lambda: "in a sweep", sweep.how_to_continue)
        output.print_error(interruption.line())
        sys.exit(code)
    if isinstance(end, _Stopped):
        failure = end.args[0]
        if wants_traceback or not isinstance(failure, UsageError):
            raise failure from failure.__cause__
        output.print_error(f"error: {failure}")
        sys.exit(1)
    if sweep is not None:
        sweep.show()
    elif isinstance(end, Exception) and not wants_traceback:
        if _command.run is None:
            with session():
                message = why_refused(end, overrides)
        else:
            causes = [text for one in (end, end.__cause__) if one and (text := sentence(one))]
            message = f"Hydra cannot start the run: {', '.join(causes) or type(end).__name__}"
        output.print_error(f"error: {message}")
        sys.exit(REFUSED)
    raise end


def _refuse(error: Exception) -> NoReturn:
    if _command.wants_traceback:
        raise error
    output.print_error(f"error: {sentence(error)}")
    sys.exit(REFUSED)
