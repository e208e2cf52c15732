"""The regression example: it runs, and uncertainty grows where there are no data."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import forked
import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "examples" / "regression.py"


@pytest.fixture(scope="module")
def example():
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("regression_example", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_short_form_runs_and_saves_a_figure(tmp_path):
    out = tmp_path / "new" / "figure.png"

    text, _ = forked.run_script(SCRIPT, "--steps", "20", "--out", str(out), cwd=tmp_path)

    assert re.search(r"spread of the draws off the data / on the data: \d+\.\d\n", text)
    assert out.read_bytes().startswith(b"\x89PNG")


def test_the_committed_figure_is_small():
    assert 10_000 < (ROOT / "docs" / "figures" / "regression.png").stat().st_size < 100_000


def test_the_curve_is_the_papers(example):
    x, y = example.curve(20_000)
    assert x.shape == y.shape == (20_000, 1)
    assert 0 <= x.min() < 0.01 < 0.49 < x.max() <= 0.5
    # at 1/4 the curve is 1/4 + .3 sin(π/2) + .3 sin(π) = .55; its slope there is 1 - 1.2 π, so
    # that ε reaches y with a factor of 1.2 π - 1
    near = (x - 0.25).abs() < 0.01
    assert y[near].mean().item() == pytest.approx(0.55, abs=0.02)
    noise = y[near] - (0.55 + (1 - 1.2 * 3.14159) * (x[near] - 0.25))
    assert noise.std().item() == pytest.approx(0.02 * (1.2 * 3.14159 - 1), rel=0.25)


def test_uncertainty_grows_where_there_are_no_data(example):
    x, y = example.curve(200)

    net = example.train_bayesian(x, y, 300)

    assert example.spread_ratio(net) > 1.5
