"""Importing the package."""

from __future__ import annotations

import forked


def test_importing_the_package_leaves_the_process_as_it_was(tmp_path):
    program = (
        "import os, signal, sys, warnings; "
        "state = lambda: ([signal.getsignal(n) for n in (2, 15)], dict(os.environ), sys.argv); "
        "before = state(); import bbq_torchrl; assert state() == before; "
        "assert not {'torch', 'hydra'} & sys.modules.keys()"
    )
    forked.python("-W", "error", "-c", program, cwd=tmp_path)
