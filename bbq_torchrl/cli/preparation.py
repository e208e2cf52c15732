"""The command line of ``train.py``, checked before Hydra runs anything.

Hydra composes, names run folders, sweeps and launches. Before it does, the command line is composed
here (each job of a sweep too), so that a wrong key, value, combination, device or corpus is refused
in one sentence, with exit code 2, before a folder exists. The step also reserves the run folder
(two runs of the same second never share one) and turns ``resume=<folder>`` into the configuration
of that folder.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hydra._internal.callbacks import Callbacks
from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import run_job
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from bbq_torchrl import output
from bbq_torchrl.cli.folders import quoted, refuse_other_folder, run_folder, run_lock
from bbq_torchrl.cli.messages import refuse_second_folder, too_large
from bbq_torchrl.cli.resume import folder_to_resume, resumed_config, run_to_resume
from bbq_torchrl.cli.store import compose_raw, register_options, searched, session, to_config
from bbq_torchrl.cli.sweeps import Check, Sweep, prepare_sweep, refuse_unswept
from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import load_folder
from bbq_torchrl.options.settings import ConfigError
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Sequence
    from contextlib import ExitStack

    from bbq_torchrl.domains import Domain

__all__ = ["Prepared", "SingleRun", "prepare"]


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
class Prepared:
    """A command line for Hydra; a single run or a sweep where it is one."""

    arguments: list[str]
    run: SingleRun | None = None
    sweep: Sweep | None = None


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
    refuse_second_folder(arguments)
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
            refuse_unswept(composed, parsed.overrides)
            refuse_other_folder(parsed.overrides, "sweep", "a sweep (--multirun)", "run")
            folder = folder_to_resume(composed.resume)
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
        sweep = prepare_sweep(hydra_session, parsed.overrides, check)
    return Prepared([*arguments, f"hydra.sweep.dir={quoted(sweep.folder)}"], sweep=sweep)


def _refuse_flag(message: str) -> NoReturn:
    """Takes the place of argparse's own, which would print how all of Hydra's flags are used."""
    raise ConfigError(f"{sentence(message)}; see --help")


def _refuse_unread(parsed: Namespace) -> None:
    for flag in ("config_path", "config_name", "experimental_rerun"):
        if getattr(parsed, flag, None) is not None:
            name = "--" + flag.replace("_", "-")
            raise ConfigError(f"{name} is not supported: choose by <group>=<option>")


def _compose_single(hydra_session: Any, overrides: Sequence[str]) -> DictConfig | None:
    """The configuration of a single run with Hydra's part, None where a sweep is asked for."""
    try:
        composed = compose_raw(overrides, run=run_to_resume(overrides))
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
