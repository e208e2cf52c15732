"""A single run: composed once with Hydra's own part, and run as Hydra runs a job."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hydra._internal.callbacks import Callbacks
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import run_job
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from bbq_torchrl.cli.store import compose_raw
from bbq_torchrl.options.settings import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options import Config

__all__ = ["SingleRun", "compose_single", "override_hydra", "without_hydra"]


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


def compose_single(hydra_session: Any, overrides: Sequence[str]) -> DictConfig | None:
    """The configuration of a single run with Hydra's part, None where a sweep is asked for."""
    try:
        composed = compose_raw(overrides, with_hydra=True)
    except ConfigError:
        # Values of a sweep cannot be composed; an experiment, too, may ask for one.
        if hydra_session.get_mode("config", list(overrides)) is RunMode.MULTIRUN:
            return None
        raise
    return None if composed.hydra.mode is RunMode.MULTIRUN else composed


def override_hydra(composed: DictConfig, overrides: Sequence[str], hydra_session: Any) -> None:
    """Changes keys of Hydra's own part, as if they had been on the command line."""
    parser = OverridesParser.create(config_loader=hydra_session.config_loader)
    with read_write(composed), open_dict(composed):
        composed.hydra.mode = RunMode.RUN
        for override in parser.parse_overrides(list(overrides)):
            OmegaConf.update(composed, override.key_or_group, override.value())
            composed.hydra.overrides.hydra.append(override.input_line)


def without_hydra(composed: DictConfig) -> DictConfig:
    """The configuration without Hydra's own part."""
    plain = composed.copy()
    OmegaConf.set_struct(plain, False)
    OmegaConf.set_readonly(plain, False)
    del plain["hydra"]
    return plain
