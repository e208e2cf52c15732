"""Options that a test registers, and that are gone after it."""

import sys
from contextlib import contextmanager

import pytest

from bbq_torchrl.options import registry


@contextmanager
def own_options():
    """Removes what was registered within, and folders of the module path."""
    known = {group: dict(options) for group, options in registry.schemas().items()}
    with pytest.MonkeyPatch.context() as patch:
        # The registry forgets nothing: outside of tests a process keeps what it has imported.
        patch.setattr(registry, "_OPTIONS", known)
        patch.setattr(sys, "path", list(sys.path))
        yield patch
