"""The command line of ``train.py``, checked before Hydra runs anything.

Hydra composes, names run folders, sweeps and launches. Before it does, the command line is composed
here (each job of a sweep too), so that a wrong key, value, combination, device or corpus is refused
in one sentence, with exit code 2, before a folder exists. The step also reserves the run folder
(two runs of the same second never share one) and turns ``resume=<folder>`` into the configuration
of that folder.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
from collections.abc import Callable, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hydra._internal.callbacks import Callbacks
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import run_job
from hydra.errors import HydraException
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from bbq_torchrl import interruption, output
from bbq_torchrl.cli.folders import (
    SWEEP_CONFIG,
    job_subfolder,
    quoted,
    refuse_other_folder,
    run_folder,
    run_lock,
    sweep_folder,
)
from bbq_torchrl.cli.messages import LAUNCHER, explain, too_large
from bbq_torchrl.cli.resume import restarted_config, resumed_config
from bbq_torchrl.cli.store import (
    compose_raw,
    register_options,
    searched,
    session,
    to_config,
)
from bbq_torchrl.cli.sweeps import table_of_runs
from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import EXPERIMENT, load_folder
from bbq_torchrl.options.settings import ConfigError
from bbq_torchrl.run_folder import CONFIG
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator

    from bbq_torchrl.domains import Domain

__all__ = ["FULL_ERROR", "Check", "Prepared", "SingleRun", "Sweep", "prepare"]

FULL_ERROR = "HYDRA_FULL_ERROR"  # Hydra's own: whoever sets it wants tracebacks

_SLURM = ("slurm", "submitit_slurm")

Check = Callable[[Config], "Domain | None"]


@dataclass(frozen=True)
class SingleRun:
    """A single run, which nothing has to be composed, checked or loaded for any more."""

    composed: DictConfig
    config: Config
    domain: Domain | None
    loader: Any

    def start(self, task: Callable[[SingleRun], float]) -> None:
        """Runs it as Hydra runs a job: with its folder, log and record of the configuration."""
        callbacks = Callbacks(self.composed)
        callbacks.on_run_start(config=self.composed, config_name="config")
        ended = run_job(
            lambda _: task(self),
            config=self.composed,
            job_dir_key="hydra.run.dir",
            job_subdir_key=None,
            hydra_context=HydraContext(config_loader=self.loader, callbacks=callbacks),
        )
        callbacks.on_run_end(config=self.composed, config_name="config", job_return=ended)
        _ = ended.return_value  # raises what the task raised


@dataclass(frozen=True)
class Sweep:
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
class Prepared:
    """A command line for Hydra; a single run or a sweep where it is one."""

    arguments: list[str]
    run: SingleRun | None = None
    sweep: Sweep | None = None


def _stop_workers() -> None:
    os.environ[FULL_ERROR] = "1"  # what becomes of the jobs is not told one by one
    for worker in multiprocessing.active_children():
        worker.terminate()


def prepare(arguments: Sequence[str], check: Check, held: ExitStack) -> Prepared:
    """The command line for Hydra, once everything on it has been checked.

    Args:
        arguments: the command line without the program's name.
        check: what else to check of a configuration before anything runs, such as its device and
            its corpus; returns the domain that it loaded, if any.
        held: takes the lock of a single run.

    Raises:
        ConfigError: one sentence that says what is wrong and what is allowed.
        ValueError or OSError: what ``check`` raises.
    """
    parser = get_args_parser()
    parser.error = _refuse_flag  # type: ignore[method-assign]
    parsed = parser.parse_args(list(arguments))
    if parsed.config_dir is not None:
        load_folder(Path(parsed.config_dir))
    register_options()
    if parsed.help or parsed.hydra_help or parsed.cfg or parsed.info or parsed.shell_completion:
        held.enter_context(output.collected())
        return Prepared(list(arguments))
    if (refusal := too_large(parsed.overrides)) is not None:
        raise ConfigError(refusal)
    with session() as hydra_session:
        _refuse_unread(parsed)
        composed = None if parsed.multirun else _compose_single(hydra_session, parsed.overrides)
        if composed is not None:
            refuse_other_folder(parsed.overrides, "sweep", "a sweep (--multirun)", "run")
            folder = _resumed_folder(composed.resume)
            if folder is not None:
                held.enter_context(run_lock(folder))
            config = to_config(composed, Config)
            if config.resume is not None:
                config = resumed_config(config, parsed.overrides)
            domain = check(config)
            extra = run_folder(composed, folder, held)
            _override_hydra(composed, extra, hydra_session)
            run = SingleRun(composed, config, domain, hydra_session.config_loader)
            return Prepared([*arguments, *extra], run=run)
        composed, jobs = _sweep(hydra_session, parsed.overrides)
        refuse_other_folder(parsed.overrides, "run", "a single run", "sweep")
        launcher = composed.hydra.runtime.choices[LAUNCHER]
        if composed.hydra.launcher.get("n_jobs") == 0:
            raise ConfigError("hydra.launcher.n_jobs must be a number of processes or -1, got 0")
        if launcher in _SLURM and shutil.which("sbatch") is None:
            raise ConfigError(
                f"{LAUNCHER}={launcher} needs the program sbatch, which is not on this machine: "
                "start the sweep where SLURM's jobs are submitted"
            )
        configs = []
        for job in jobs:
            if job.resume is not None:
                raise ConfigError("resume cannot be combined with --multirun")
            configs.append(to_config(job, Config))
            check(configs[-1])
        folder = sweep_folder(composed, parsed.overrides, len(jobs))
        if (folder / SWEEP_CONFIG).is_file():
            # Hydra writes into a job's folder before the job can refuse it.
            for number, (job, config) in enumerate(zip(jobs, configs, strict=True)):
                restarted_config(config, folder / job_subfolder(job, number))
        sweep = Sweep(folder, len(jobs), launcher)
    return Prepared([*arguments, f"hydra.sweep.dir={quoted(sweep.folder)}"], sweep=sweep)


def _refuse_flag(message: str) -> NoReturn:
    """Takes the place of argparse's own, which would print how all of Hydra's flags are used."""
    raise ConfigError(f"{sentence(message)}; see --help")


def _refuse_unread(parsed: Namespace) -> None:
    for flag in ("config_path", "config_name", "experimental_rerun"):
        if getattr(parsed, flag, None) is not None:
            name = "--" + flag.replace("_", "-")
            raise ConfigError(f"{name} is not supported: choose by <group>=<option>")


def _sweep(hydra_session: Any, arguments: Sequence[str]) -> tuple[DictConfig, list[DictConfig]]:
    """The configuration of a sweep, and those of its jobs, with Hydra's part.

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
        composed = compose_raw(of_sweeper)
        sweeper = composed.hydra.sweeper
        if not str(sweeper._target_).endswith(f".{BasicSweeper.__name__}"):
            return composed, []
        swept = [f"{key}={value}" for key, value in (sweeper.params or {}).items()]
        parsed = parser.parse_overrides([*swept, *arguments])
        jobs = [list(job) for batch in BasicSweeper.split_arguments(parsed, None) for job in batch]
    except HydraException as error:
        raise ConfigError(explain(error, arguments)) from error
    if not jobs:
        raise ConfigError(
            f"{sentence(' '.join(arguments))} is a sweep without a job: a range() is empty, or a "
            "glob() names no option "
            "(globs of a folder of options stand behind its name: '+experiment/agents=glob(*)')"
        )
    composed_jobs = [compose_raw(job) for job in jobs]
    return composed_jobs[0], composed_jobs


def _resumed_folder(resume: str | None) -> Path | None:
    """The run folder to go on in, if it is one."""
    if resume is None:
        return None
    folder = Path(resume).expanduser().resolve()
    return folder if (folder / CONFIG).is_file() else None


def _compose_single(hydra_session: Any, overrides: Sequence[str]) -> DictConfig | None:
    """The configuration of a single run with Hydra's part, None where a sweep is asked for."""
    try:
        composed = compose_raw(overrides)
    except ConfigError:
        # Values of a sweep cannot be composed; an experiment, too, may ask for one.
        if hydra_session.get_mode("config", searched(overrides)) is RunMode.MULTIRUN:
            return None
        raise
    return None if composed.hydra.mode is RunMode.MULTIRUN else composed


def _override_hydra(composed: DictConfig, overrides: Sequence[str], hydra_session: Any) -> None:
    """Changes keys of Hydra's own part, as if they had been on the command line."""
    parser = OverridesParser.create(config_loader=hydra_session.config_loader)
    with read_write(composed), open_dict(composed):
        composed.hydra.mode = RunMode.RUN
        for override in parser.parse_overrides(list(overrides)):
            OmegaConf.update(composed, override.key_or_group, override.value())
            composed.hydra.overrides.hydra.append(override.input_line)
