"""A command line as ``train.py`` prepares it."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from bbq_torchrl.runs.compose import compose_raw, session
from bbq_torchrl.runs.prepare import final_config, prepare_run

if TYPE_CHECKING:
    from pathlib import Path

    from omegaconf import DictConfig

    from bbq_torchrl.options import Config


def prepared(*overrides: str) -> tuple[Config, DictConfig]:
    """The configuration of a run, and Hydra's part with the name of its folder."""
    with ExitStack() as locks, session():
        composed = compose_raw(overrides)
        return prepare_run(composed, locks), composed.hydra


def resumed(folder: Path, *overrides: str) -> Config:
    """The configuration that ``train.py resume=<folder>`` trains with."""
    with session():
        return final_config(compose_raw([f"resume={folder}", *overrides]), overrides)
