"""A command line as ``train.py`` prepares it."""

from __future__ import annotations

from contextlib import ExitStack

import pytest

from bbq_torchrl.runs import checks, preparation


def prepare(arguments, check=lambda config: None):
    """What the command line asks for; the run folder's lock is let go."""
    with ExitStack() as held, pytest.MonkeyPatch.context() as patch:
        patch.setattr(checks, "check", check)
        return preparation.prepare(arguments, held)
