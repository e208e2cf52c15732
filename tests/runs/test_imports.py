"""What importing the package does, and import paths of 0.1."""

from __future__ import annotations

import importlib

import forked
import pytest

from bbq_torchrl.moved import MOVED
from bbq_torchrl.runs import build, compose, train


@pytest.mark.parametrize(
    ("old", "name", "now"),
    [
        ("run", "run", train.run),
        ("cli.store", "compose", compose.compose),
        ("cli.training", "build_trainer", train.build_trainer),
        ("cli.training", "spike_policy", build.spike_policy),
    ],
)
def test_an_old_path_leads_to_the_new_place_with_a_warning(old, name, now):
    module = importlib.import_module(f"bbq_torchrl.{old}")
    with pytest.warns(DeprecationWarning, match=f"bbq_torchrl.{old}.{name} has moved to"):
        assert getattr(module, name) is now


@pytest.mark.parametrize("old", MOVED)
def test_an_old_path_has_no_other_names(old):
    module = importlib.import_module(f"bbq_torchrl.{old}")
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = module.nothing


def test_importing_the_package_leaves_the_process_as_it_was(tmp_path):
    program = (
        "import os, signal, sys, warnings; "
        "state = lambda: ([signal.getsignal(n) for n in (2, 15)], dict(os.environ), sys.argv); "
        "before = state(); import bbq_torchrl; assert state() == before; "
        "assert not {'torch', 'hydra'} & sys.modules.keys()"
    )
    forked.python("-W", "error", "-c", program, cwd=tmp_path)
