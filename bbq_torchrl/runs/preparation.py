"""The command line of ``train.py``, checked before Hydra runs anything.

Hydra composes, names run folders, sweeps and launches. Before it does, the command line is composed
here (each job of a sweep too), so that a wrong key, value, combination, device or corpus is refused
in one sentence, with exit code 2, before a folder exists. The step also reserves the run folder
(two runs of the same second never share one) and turns ``resume=<folder>`` into the configuration
of that folder.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hydra._internal.callbacks import Callbacks
from hydra._internal.utils import get_args_parser
from hydra.core.utils import run_job
from hydra.errors import HydraException
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, open_dict, read_write

from bbq_torchrl import output
from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import load_folder
from bbq_torchrl.options.settings import ConfigError
from bbq_torchrl.run_folder import CONFIG
from bbq_torchrl.runs.compose import compose_raw, register_options, searched, session, to_config
from bbq_torchrl.runs.folders import refuse_other_folder, run_folder, run_lock
from bbq_torchrl.runs.overrides import refuse_second_folder, too_large
from bbq_torchrl.runs.resume import folder_to_resume, resumed
from bbq_torchrl.runs.sweeps import Sweep, prepare_sweep, refuse_unswept
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Sequence
    from contextlib import ExitStack

    from bbq_torchrl.domains import Domain


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


def prepare(arguments: Sequence[str], held: ExitStack) -> SingleRun | Sweep | None:
    """Checks a command line, and what it asks for: None where Hydra only shows something.

    Args:
        arguments: the command line without the program's name.
        held: takes the lock of a single run.

    Raises:
        ConfigError: one sentence that says what is wrong and what is allowed.
        ValueError or OSError: a corpus that cannot be used.
    """
    parser = get_args_parser()
    parser.error = _refuse_flag  # type: ignore[method-assign]
    parsed = parser.parse_args(list(arguments))
    refuse_second_folder(arguments)
    if parsed.config_dir is not None:
        load_folder(Path(parsed.config_dir))
    register_options()
    if parsed.help or parsed.hydra_help or parsed.cfg or parsed.info or parsed.shell_completion:
        held.enter_context(output.collected())
        return None
    if (refusal := too_large(parsed.overrides)) is not None:
        raise ConfigError(refusal)
    with session() as hydra_session:
        _refuse_unread(parsed)
        folder = None if parsed.multirun else folder_to_resume(parsed.overrides)
        if folder is not None:
            if (folder / CONFIG).is_file():
                held.enter_context(run_lock(folder))
            composed, config = resumed(folder, parsed.overrides)
        elif parsed.multirun or (new := _new_run(hydra_session, parsed.overrides)) is None:
            return prepare_sweep(hydra_session, parsed.overrides)
        else:
            composed, config = new
        refuse_other_folder(parsed.overrides, "sweep", "a sweep (--multirun)", "run")
        from bbq_torchrl.runs.checks import check  # torch and torchrl take ten seconds

        domain = check(config)
        with read_write(composed), open_dict(composed):
            composed.hydra.mode = RunMode.RUN
            if folder is not None:
                composed.hydra.output_subdir = None  # as the first process wrote it
            composed.hydra.run.dir = str(folder or run_folder(composed, parsed.overrides, held))
        return SingleRun(composed, config, domain, hydra_session.config_loader)


def _refuse_flag(message: str) -> NoReturn:
    """Takes the place of argparse's own, which would print how all of Hydra's flags are used."""
    raise ConfigError(f"{sentence(message)}; see --help")


def _refuse_unread(parsed: Namespace) -> None:
    for flag in ("config_path", "config_name", "experimental_rerun"):
        if getattr(parsed, flag, None) is not None:
            name = "--" + flag.replace("_", "-")
            raise ConfigError(f"{name} is not supported: choose by <group>=<option>")
    for flag in ("resolve", "package"):
        if getattr(parsed, flag):
            raise ConfigError(f"--{flag} is for --cfg, which shows a configuration")


def _new_run(hydra_session: Any, overrides: Sequence[str]) -> tuple[DictConfig, Config] | None:
    """The configuration of a new run, with and without Hydra's part; None for a sweep."""
    try:
        composed = compose_raw(overrides)
    except ConfigError:
        # Values of a sweep cannot be composed; an experiment, too, may ask for one.
        with suppress(HydraException):
            if hydra_session.get_mode("config", searched(overrides)) is RunMode.MULTIRUN:
                return None
        raise
    if composed.hydra.mode is RunMode.MULTIRUN:
        return None
    refuse_unswept(composed, overrides)
    config = to_config(composed, Config)
    if config.resume is not None:
        raise ConfigError(
            f"resume must be on the command line itself, as resume=<folder>, got {config.resume}"
        )
    return composed, config
