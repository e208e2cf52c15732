"""The command line of ``train.py``: everything is checked before Hydra runs anything.

Hydra composes, names run folders, sweeps and launches. Around it stands one step: the command line
is composed beforehand (each job of a sweep too), so that a wrong key, value, combination, device or
corpus is refused in one sentence, with exit code 2, before a folder exists. The step also reserves
the run folder (two runs of the same second never share one) and turns ``resume=<folder>`` into the
configuration of that folder. A single run is then run as it was composed and checked; only the jobs
of a sweep, which may start on another machine, are composed again by Hydra.
"""

from __future__ import annotations

import functools
import logging
import multiprocessing
import os
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import hydra
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import CompactHydraException, HydraException

from bbq_torchrl import interruption, output
from bbq_torchrl.cli.folders import (
    SWEEP_CONFIG,
    check_job_name,
    job_subfolder,
    quoted,
    refuse_other_folder,
    run_folder,
    sweep_folder,
)
from bbq_torchrl.cli.launchers import LAUNCHER, check_launcher
from bbq_torchrl.cli.messages import explain, too_large, train_command
from bbq_torchrl.cli.resume import (
    RUN_CONFIG,
    restarted_config,
    resumed_config,
)
from bbq_torchrl.cli.run_lock import run_lock
from bbq_torchrl.cli.single_run import SingleRun, compose_single, override_hydra, without_hydra
from bbq_torchrl.cli.store import (
    compose_raw,
    conf_folder,
    options,
    register_options,
    session,
    to_config,
)
from bbq_torchrl.cli.sweeps import table_of_runs
from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import EXPERIMENT, load_folder
from bbq_torchrl.options.settings import ConfigError
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator

    from omegaconf import DictConfig

    from bbq_torchrl.domains import Domain

__all__ = ["REFUSED", "UsageError", "command", "prepare"]

_LOG = logging.getLogger(__name__)

REFUSED = 2
"""Exit code of a command that was refused; a run that an error stops ends with 1, Hydra's code."""

_FULL_ERROR = "HYDRA_FULL_ERROR"  # Hydra's own: whoever sets it wants tracebacks

Task = Callable[[Config, Path, "Domain | None"], float]
Check = Callable[[Config], "Domain | None"]
UsageErrors = Callable[[], "tuple[type[Exception], ...]"]


class UsageError(CompactHydraException):
    """A job that stopped for a reason that its text says; Hydra prints it without a traceback."""


class _Stopped(BaseException):
    """Carries what stopped a run past Hydra, which would add to what it says."""


def command(check: Check, usage_errors: UsageErrors) -> Callable[[Task], Callable[[], None]]:
    """Makes a training function the main function of a command line.

    Args:
        check: what else to check of a configuration before anything runs, such as its device and
            its corpus; returns the domain that it loaded, if any, and raises ``ValueError`` or
            ``OSError``.
        usage_errors: returns the exceptions of a run whose text is enough for a person.

    Returns:
        a decorator for a function from configuration, run folder and domain (None: not loaded yet)
        to the final success rate, which is what sweepers get.
    """

    def decorate(task: Task) -> Callable[[], None]:
        @functools.wraps(task)
        def job_of_a_sweep(composed: DictConfig) -> float:
            folder = _told_folder()
            try:
                config = to_config(composed, Config)
                interruption.listen()
                interruption.check()
                return task(restarted_config(config, folder), folder, None)
            except interruption.Interrupted:
                raise UsageError(interruption.line()) from None  # the other jobs end in good order
            except Exception as error:
                # Hydra reports the first job that fails, at the end; the log has each.
                _LOG.error("this run failed: %s", sentence(error) or type(error).__name__)
                raise _failure(error) from error

        def single(run: SingleRun) -> float:
            try:
                return task(run.config, _told_folder(), run.domain)
            except Exception as error:
                raise _Stopped(_failure(error)) from error

        def _failure(error: Exception) -> Exception:
            tells = isinstance(error, (ConfigError, OSError, *usage_errors()))
            return UsageError(sentence(error)) if tells else error

        @functools.wraps(task)
        def main() -> None:
            arguments = sys.argv[1:]
            with ExitStack() as held:
                try:
                    prepared = _prepare(arguments, check, held)
                except (ValueError, OSError) as error:
                    _refuse(error)
                run, sweep = prepared.run, prepared.sweep
                sys.argv[1:] = prepared.arguments
                logging.raiseExceptions = False  # a full disk is told once, not for every message
                try:
                    if run is not None:
                        run.start(single)
                        return
                    with sweep.interruptible() if sweep else _handing_on_errors():
                        hydra.main(
                            version_base="1.3", config_path=str(conf_folder()), config_name="config"
                        )(job_of_a_sweep)()
                    if sweep is not None:
                        sweep.show()
                except BaseException as end:
                    _end(end, sweep, arguments)
                finally:
                    sys.argv[1:] = arguments
                    output.settle()

        return main

    return decorate


def prepare(arguments: Sequence[str], check: Check) -> list[str]:
    """The command line for Hydra, once everything on it has been checked.

    Args:
        arguments: the command line without the program's name.
        check: see :func:`command`.

    Raises:
        ConfigError: one sentence that says what is wrong and what is allowed.
        ValueError or OSError: what ``check`` raises.
    """
    with ExitStack() as held:
        return _prepare(arguments, check, held).arguments


@dataclass(frozen=True)
class _Sweep:
    """Where a sweep's runs are, and how many (0 where only its sweeper knows)."""

    folder: Path
    jobs: int
    launcher: str

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Within it, a signal has the jobs on this machine end their rounds first."""
        interruption.tell(lambda: "in a sweep", self.how_to_go_on)
        if self.launcher not in ("cores", "joblib", "basic"):
            yield
            return
        with interruption.gently(_stop_workers):
            yield

    def show(self) -> None:
        """Writes the table of its runs to stderr."""
        output.complain(table_of_runs(self.folder, self.jobs))

    def how_to_go_on(self) -> str:
        """What is finished, and what goes on with the others."""
        finished = table_of_runs(self.folder, self.jobs).splitlines()[0]
        return f"{finished}; the same command with hydra.sweep.dir={self.folder} goes on"


@dataclass(frozen=True)
class _Prepared:
    """A command line for Hydra; a single run or a sweep where it is one."""

    arguments: list[str]
    run: SingleRun | None = None
    sweep: _Sweep | None = None


def _told_folder() -> Path:
    """The folder of the run that Hydra has begun; a signal will say how to go on in it."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    interruption.tell(how_to_go_on=lambda: _how_to_go_on(folder))
    return folder


def _stop_workers() -> None:
    os.environ[_FULL_ERROR] = "1"  # what becomes of the jobs is not told one by one
    for worker in multiprocessing.active_children():
        worker.terminate()


def _how_to_go_on(folder: Path) -> str:
    if not (folder / RUN_CONFIG).is_file():
        return "the same command begins again"
    plain = re.fullmatch(r"[\w./~@%+:-]+", os.fspath(folder)) is not None
    override = f"resume={folder if plain else quoted(folder)}"
    return f"{shlex.join([*train_command(), override])} goes on"


@contextmanager
def _handing_on_errors() -> Iterator[None]:
    """Within it, Hydra raises its errors instead of printing them with a traceback."""
    before = os.environ.get(_FULL_ERROR)
    os.environ[_FULL_ERROR] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_FULL_ERROR]
        else:
            os.environ[_FULL_ERROR] = before


def _wants_traceback() -> bool:
    return os.environ.get(_FULL_ERROR) == "1"


def _end(end: BaseException, sweep: _Sweep | None, arguments: Sequence[str]) -> NoReturn:
    """Ends the command by a sentence where there is one."""
    number = interruption.received()
    if number is not None:
        if sweep is not None:
            interruption.tell(lambda: "in a sweep", sweep.how_to_go_on)
        output.complain(interruption.line())
        sys.exit(128 + number)
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
        return explain(error, arguments, options)
    causes = [said for cause in (error, error.__cause__) if cause and (said := sentence(cause))]
    return f"Hydra cannot begin the run: {': '.join(causes) or type(error).__name__}"


def _prepare(arguments: Sequence[str], check: Check, held: ExitStack) -> _Prepared:
    """What the command line is, checked; ``held`` takes the lock of a single run."""
    parser = get_args_parser()
    parser.error = _refuse_flag  # type: ignore[method-assign]
    parsed = parser.parse_args(list(arguments))
    if parsed.config_dir is not None:
        load_folder(Path(parsed.config_dir))
    register_options()
    if parsed.help or parsed.hydra_help or parsed.cfg or parsed.info or parsed.shell_completion:
        held.enter_context(output.collected())
        return _Prepared(list(arguments))
    if (refusal := too_large(parsed.overrides)) is not None:
        raise ConfigError(refusal)
    with session() as hydra_session:
        _refuse_unread(parsed)
        composed = None if parsed.multirun else compose_single(hydra_session, parsed.overrides)
        if composed is not None:
            check_job_name(composed)
            refuse_other_folder(parsed.overrides, "sweep", "a sweep (--multirun)", "run")
            folder = _resumed_folder(composed.resume)
            if folder is not None:
                held.enter_context(run_lock(folder))
            config = _run_config(without_hydra(composed), parsed.overrides)
            domain = check(config)
            extra = run_folder(composed, folder, held)
            override_hydra(composed, extra, hydra_session)
            run = SingleRun(composed, config, domain, hydra_session.config_loader)
            return _Prepared([*arguments, *extra], run=run)
        composed, jobs = _sweep(hydra_session, parsed.overrides)
        check_job_name(composed)
        refuse_other_folder(parsed.overrides, "run", "a single run", "sweep")
        launcher = composed.hydra.runtime.choices[LAUNCHER]
        check_launcher(launcher, composed.hydra.launcher)
        configs = []
        for overrides in jobs:
            job = compose_raw(overrides)
            if job.resume is not None:
                raise ConfigError("resume cannot be combined with --multirun")
            configs.append(to_config(job, Config))
            check(configs[-1])
        folder = sweep_folder(composed, parsed.overrides, len(jobs))
        if (folder / SWEEP_CONFIG).is_file():
            # Hydra writes into a job's folder before the job can refuse it.
            for number, (overrides, config) in enumerate(zip(jobs, configs, strict=True)):
                restarted_config(config, folder / job_subfolder(overrides, number))
        sweep = _Sweep(folder, len(jobs), launcher)
    return _Prepared([*arguments, f"hydra.sweep.dir={quoted(sweep.folder)}"], sweep=sweep)


def _refuse_flag(message: str) -> NoReturn:
    """Takes the place of argparse's own, which would print how all of Hydra's flags are used."""
    raise ConfigError(f"{sentence(message)}; see --help")


def _refuse_unread(parsed: Namespace) -> None:
    for flag in ("config_path", "config_name", "experimental_rerun"):
        if getattr(parsed, flag, None) is not None:
            name = "--" + flag.replace("_", "-")
            raise ConfigError(f"{name} is not supported: choose by <group>=<option>")


def _run_config(composed: DictConfig, overrides: Sequence[str]) -> Config:
    config = to_config(composed, Config)
    return config if config.resume is None else resumed_config(config, overrides)


def _sweep(hydra_session: Any, arguments: Sequence[str]) -> tuple[DictConfig, list[list[str]]]:
    """The configuration of a sweep, and the overrides of each of its jobs.

    Only Hydra's own sweeper says beforehand what its jobs are. Of another one (Optuna's, say) none
    are returned: each job is checked when it starts.
    """
    parser = OverridesParser.create(config_loader=hydra_session.config_loader)
    try:
        parsed = parser.parse_overrides(list(arguments))
        of_sweeper = [
            str(item.input_line)
            for item in parsed
            if not item.is_sweep_override()
            and item.key_or_group.partition(".")[0].partition("/")[0] in ("hydra", EXPERIMENT)
        ]
        composed = compose_raw(of_sweeper, with_hydra=True)
        sweeper = composed.hydra.sweeper
        if not str(sweeper._target_).endswith(f".{BasicSweeper.__name__}"):
            return composed, []
        swept = [f"{key}={value}" for key, value in (sweeper.params or {}).items()]
        parsed = parser.parse_overrides([*swept, *arguments])
        jobs = [list(job) for batch in BasicSweeper.split_arguments(parsed, None) for job in batch]
    except HydraException as error:
        raise ConfigError(explain(error, arguments, options)) from error
    if not jobs:
        raise ConfigError(
            f"{sentence(' '.join(arguments))} is a sweep without a job: a range() is empty, or a "
            "glob() names no option "
            "(globs of a folder of options stand behind its name: '+experiment/agents=glob(*)')"
        )
    return compose_raw(jobs[0], with_hydra=True), jobs


def _resumed_folder(resume: str | None) -> Path | None:
    """The run folder to go on in, if it is one."""
    if resume is None:
        return None
    folder = Path(resume).expanduser().resolve()
    return folder if (folder / RUN_CONFIG).is_file() else None


def _refuse(error: Exception) -> NoReturn:
    if _wants_traceback():
        raise error
    output.complain(f"error: {sentence(error)}")
    sys.exit(REFUSED)
