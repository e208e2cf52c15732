"""A command line as ``train.py`` hands it to Hydra."""

from __future__ import annotations

from contextlib import ExitStack

from bbq_torchrl.cli import preparation


def prepare(arguments, check=lambda config: None):
    """The checked command line; the run folder's lock is let go."""
    with ExitStack() as held:
        return preparation.prepare(arguments, check, held).arguments
