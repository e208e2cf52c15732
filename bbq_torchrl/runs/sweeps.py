"""Sweeps: checking all jobs before the first starts, the folder, and the table of runs."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import sys
from collections import Counter
from contextlib import contextmanager, nullcontext, redirect_stderr
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf, open_dict, read_write

from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import EXPERIMENT
from bbq_torchrl.runs.cluster import watched_head
from bbq_torchrl.runs.compose import compose_raw, session, to_config
from bbq_torchrl.runs.folders import named_folder, refuse_links, refuse_other_folder, reserve
from bbq_torchrl.runs.overrides import LAUNCHER, key_of, read_override
from bbq_torchrl.runs.resume import NOT_SWEPT, is_finished, restarted_config, run_config
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.files import (
    CONFIG,
    LOG,
    OVERRIDES,
    RESULT,
    folder_of,
    numbers_in_order,
    read_yaml,
)
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import TextIO

    from hydra.core.override_parser.types import Override
    from omegaconf import DictConfig

FULL_ERROR = "HYDRA_FULL_ERROR"  # Hydra's variable; users set it for tracebacks

_OF_A_JOB = "Error executing job with overrides"
_SWEEPER = "BasicSweeper"  # Hydra's default
_SLURM = ("slurm", "submitit_slurm")
_RAY = "ray_tasks"
_HEAD = ("run", "overrides", "final success", "state")

SWEEP_CONFIG = "multirun.yaml"
"""A file that Hydra writes into a sweep's folder before the first job."""


@dataclass(frozen=True)
class Sweep:
    """The folder of a sweep, the number of its jobs (0 if only the sweeper knows), its launcher."""

    folder: Path
    jobs: int
    launcher: str

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """In the context, a signal lets jobs on this machine finish their rounds."""
        interruption.tell(lambda: "in a sweep", self.how_to_continue)
        is_here = self.launcher in ("cores", "joblib", "basic")
        quiet = cast("Any", sys.stderr and _StandardError(sys.stderr))
        with (
            interruption.on_interrupt(_stop_workers) if is_here else nullcontext(),
            watched_head(self.show, self.how_to_continue)
            if self.launcher == _RAY
            else nullcontext(),
            redirect_stderr(quiet),
        ):
            yield

    def show(self) -> None:
        """Prints the table of runs to standard error."""
        output.print_error(table_of_runs(self.folder, self.jobs))

    def how_to_continue(self) -> str:
        """Returns how many runs are finished, and the command that continues the others."""
        finished = table_of_runs(self.folder, self.jobs).splitlines()[0]
        return f"{finished}; the same command with hydra.sweep.dir={self.folder} continues"


def prepare_sweep(overrides: Sequence[str]) -> Sweep:
    """Composes and checks every job of a sweep, and makes its folder.

    Args:
        overrides: the command line.

    Raises:
        ConfigError: one sentence that names the fault and the allowed values.
        ValueError or OSError: an unusable corpus.
    """
    from bbq_torchrl.runs import checks  # torch and torchrl take ten seconds

    with session() as hydra_session:
        composed, jobs = _composed(hydra_session, overrides)
    refuse_other_folder(overrides, "run", "a single run", "sweep")
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
            raise ConfigError(NOT_SWEPT)
        configs.append(to_config(job, Config))
        checks.check(configs[-1])
    subfolders = [_job_subfolder(job, number) for number, job in enumerate(jobs)]
    _check_subfolders(composed, subfolders)
    folder = _sweep_folder(composed, overrides)
    if (folder / SWEEP_CONFIG).is_file():
        # Hydra writes into a job's folder before the job can refuse it.
        for config, subfolder in zip(configs, subfolders, strict=True):
            for place in (Path(subfolder), *Path(subfolder).parents):
                refuse_links(folder / place)
            restarted_config(config, folder / subfolder)
    return Sweep(folder, len(jobs), launcher)


def silence_jobs() -> None:
    """Stops Hydra from printing each job's exception: the sweep prints one line."""
    os.environ[FULL_ERROR] = "1"


class _StandardError:
    """Standard error that drops Hydra's error line of each job after a signal."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Writes the text, unless it is such a line."""
        is_dropped = interruption.exit_code() and text.startswith(_OF_A_JOB)
        return len(text) if is_dropped else self._stream.write(text)


def _stop_workers() -> None:
    silence_jobs()
    for worker in multiprocessing.active_children():
        worker.terminate()


def _composed(hydra_session: Any, arguments: Sequence[str]) -> tuple[DictConfig, list[DictConfig]]:
    """Returns the configuration of a sweep and those of its jobs, with Hydra's part.

    Only the jobs of Hydra's default sweeper are known in advance. With another one, such as
    Optuna's, no jobs are returned, and each is checked when it starts.
    """
    parser = OverridesParser.create(config_loader=hydra_session.config_loader)
    parsed = [read_override(item, parser) for item in arguments]
    of_sweeper = [
        str(item.input_line)
        for item in parsed
        if not item.is_sweep_override()
        and item.key_or_group.partition(".")[0].partition("/")[0] in ("hydra", EXPERIMENT)
    ]
    composed = compose_raw(of_sweeper)
    sweeper = composed.hydra.sweeper
    if not str(sweeper._target_).endswith(f".{_SWEEPER}"):
        return composed, []
    swept = [f"{key}={value}" for key, value in (sweeper.params or {}).items()]
    choices: dict[str, list[str]] = {}
    for item in [*(read_override(text, parser) for text in swept), *parsed]:
        choices[item.get_key_element()] = _elements(item)
    jobs = [list(job) for job in product(*choices.values())]
    if not jobs:
        raise ConfigError(
            f"{sentence(' '.join(arguments))} is a sweep without a job: a range() is empty, or a "
            "glob() names no option "
            "(globs of a folder of options stand behind its name: '+experiment/agents=glob(*)')"
        )
    composed_jobs = [compose_raw(job) for job in jobs]
    for composed, job in zip(composed_jobs, jobs, strict=True):
        refuse_unswept(composed, job)
    return composed_jobs[0], composed_jobs


def _elements(override: Override) -> list[str]:
    """Expands an override of a sweep into the overrides of its jobs."""
    key = override.get_key_element()
    if not override.is_sweep_override():
        return [f"{key}={override.get_value_element_as_str()}"]
    if not override.is_discrete_sweep():
        kind = "" if override.value_type is None else override.value_type.name
        raise ConfigError(f"{_SWEEPER} does not support sweep type : {kind}")
    return [f"{key}={value}" for value in override.sweep_string_iterator()]


def refuse_unswept(composed: DictConfig, overrides: Sequence[str]) -> None:
    """Refuses to run a sweep, such as an experiment that varies a key, as a single run.

    Args:
        composed: the configuration of the run, with Hydra's part.
        overrides: the overrides of the run.

    Raises:
        ConfigError: a swept key is not among the overrides.
    """
    given = {key_of(item) for item in overrides}
    left = [key for key in composed.hydra.sweeper.get("params") or {} if key not in given]
    if left:
        raise ConfigError(
            f"this is a sweep over {', '.join(left)}; add --multirun, and choose one "
            "experiment, or several at once by +experiment=[one,another]"
        )


def _sweep_folder(composed: DictConfig, overrides: Sequence[str]) -> Path:
    """Returns the folder of a sweep: ``hydra.sweep.dir``, new or to continue, or a free name."""
    folder = named_folder(composed, "sweep")
    if "hydra.sweep.dir" not in map(key_of, overrides):
        return reserve(folder)
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        if not (folder / SWEEP_CONFIG).is_file():
            raise ConfigError(
                "hydra.sweep.dir must be a new folder, or that of a sweep to "
                f"continue, got {folder}, which exists and has no {SWEEP_CONFIG}"
            ) from None
    except OSError as error:
        raise ConfigError(
            f"hydra.sweep.dir must be a folder that can be made, got {folder}: {error.strerror}"
        ) from error
    return folder


def _job_subfolder(composed: DictConfig, number: int) -> str:
    """Returns the folder of a job, relative to the sweep's."""
    with read_write(composed), open_dict(composed):
        composed.hydra.job.num = number
        composed.hydra.job.id = str(number)
        return str(composed.hydra.sweep.subdir)


def _check_subfolders(composed: DictConfig, subfolders: Sequence[str]) -> None:
    """Refuses folders of jobs that are shared or outside the sweep's folder."""
    plain: Any = OmegaConf.to_container(composed.hydra.sweep, resolve=False)
    name = str(plain["subdir"])  # with unresolved references
    parts = Path(name).parts
    shared = [folder for folder, count in Counter(subfolders).items() if count > 1]
    if not parts or Path(name).is_absolute() or ".." in parts or shared:
        several = f", which is {shared[0]} for several" if shared and shared[0] != name else ""
        raise ConfigError(
            "hydra.sweep.subdir must name a separate folder for each job, in that of the sweep, "
            f"such as ${{hydra.job.num}}, got {shown(name)}{several}"
        )


def table_of_runs(sweep: Path, jobs: int) -> str:
    """Returns a line for each run of a sweep: folder, overrides, final success, state.

    Overrides that all runs share are left out.

    Args:
        sweep: the sweep's folder.
        jobs: the number of jobs; 0 if only the sweeper knows.
    """
    folders = sorted({folder_of(file) for file in sweep.rglob(CONFIG)}, key=numbers_in_order)
    overrides = [_overrides(folder) for folder in folders]
    shared = set(overrides[0]).intersection(*overrides) if len(overrides) > 1 else set()
    rows = [
        (
            str(folder.relative_to(sweep)),
            " ".join(item for item in given if item not in shared),
            *_success_and_state(folder),
        )
        for folder, given in zip(folders, overrides, strict=True)
    ]
    finished = sum(state == "finished" for *_, state in rows)
    total = max(jobs, len(rows))
    if total > len(rows):
        rows.append(("–", "", "–", f"{total - len(rows)} never started"))
    table = [_HEAD, *rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = (
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    )
    return "\n".join([f"{finished} of {total} runs in {sweep} are finished", *lines])


def _success_and_state(folder: Path) -> tuple[str, str]:
    file = folder / RESULT
    log = folder / LOG
    is_silent = log.is_file() and not log.stat().st_size  # a signal came before the job started
    unfinished = "–", "not begun" if is_silent else f"not finished: {LOG} in it says why"
    if not file.is_file():
        return unfinished
    # Imported here: it takes a second.
    from bbq_torchrl.evaluation.run_result import read_result

    try:
        rate = read_result(folder).success_rate
    except (OSError, ValueError):
        return "–", f"{RESULT} is damaged"
    try:
        finished = is_finished(folder, run_config(folder).protocol.rounds)
    except ConfigError:
        finished = False
    return (f"{rate:.3f}", "finished") if finished else unfinished


def _overrides(folder: Path) -> list[str]:
    """Returns the overrides in Hydra's file of a run; empty if it cannot be read."""
    try:
        noted = read_yaml((folder / OVERRIDES).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [item for item in noted if isinstance(item, str)] if isinstance(noted, list) else []
