"""Fixtures that every test may use: the domains, and the public corpus where it is present."""

import gc
import os

# Read when torch first looks for a GPU. Once its gradients have seen one, this process cannot be
# forked as forked.py does.
if "BBQ_TEST_CUDA" not in os.environ:
    os.environ["CUDA_VISIBLE_DEVICES"] = ""

import random
import sys
import zlib
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
DEFAULT_TCBOT = TESTS.parent.parent / "shared" / "data" / "tcbot"

# They hold no doctests, and several of one name cannot be collected as modules.
collect_ignore_glob = ["*conftest.py"]

# Until all is imported, which makes many objects and no garbage.
gc.disable()


def pytest_collectstart():
    """Before what is tested is imported. Whoever only hands out the tests imports nothing of it."""
    _prepare()


@cache
def _prepare():
    import torch
    from hypothesis import settings

    # More threads than tests at a time only get in each other's way on a small machine.
    torch.set_num_threads(1)

    # The first gradient looks for devices. Here, before torch.compile makes a build with CUDA count
    # one that is not there: that too would forbid forks.
    torch.ones((), requires_grad=True).backward()

    # What a test of Hypothesis draws depends on the test alone, as in CI; how long an example
    # takes, on the machine, and no test is about that.
    settings.register_profile(
        "same_draws", settings.default, derandomize=True, deadline=None, max_examples=30
    )
    settings.load_profile("same_draws")


def pytest_collection_finish():
    """From here on garbage is collected, but not among what was imported, which stays."""
    gc.freeze()
    gc.enable()
    if (compose := sys.modules.get("bbq_torchrl.runs.compose")) is not None:
        from tiny import composed_raw  # beside it, for composing takes a quarter of a second

        compose.compose_raw = composed_raw


@pytest.fixture(autouse=True)
def _seeded_by_its_name(request):
    """Seeds a test by its name alone, not by the tests that ran before it."""
    import numpy as np
    import torch

    seed = zlib.crc32(request.node.nodeid.encode())
    if "BBQ_TEST_CUDA" in os.environ:
        torch.manual_seed(seed)
    else:  # which, without a GPU, would keep a traceback of each call
        torch.default_generator.manual_seed(seed)
    np.random.seed(seed)
    random.seed(seed)


@pytest.fixture
def drawn_noise(monkeypatch):
    """The noise that weight draws use, in order, [replicas, weights] each."""
    from bbq_torchrl.bayes import GaussianPosterior

    drawn = []

    def fill(self, buffer):
        buffer.normal_()
        drawn.append(buffer.reshape(-1, buffer.shape[-1]).clone())

    monkeypatch.setattr(GaussianPosterior, "fill_noise_", fill)
    return drawn


@pytest.fixture(scope="module")
def without_curves():
    """Curves are empty files, and no other policy is played at the end of a run."""
    from tiny import without_drawing

    with without_drawing():
        yield


@pytest.fixture(scope="session")
def tcbot():
    """The folder of MiuLab's public corpus; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("BBQ_TCBOT", DEFAULT_TCBOT))
    if not (folder / "movie_kb.1k.p").is_file():
        pytest.skip(f"MiuLab's corpus is not in {folder}; name its folder in BBQ_TCBOT")
    return folder


@pytest.fixture(scope="session")
def miulab(tcbot):
    """MiuLab's corpus with its default files."""
    from bbq_torchrl.domains import load_miulab

    return load_miulab(tcbot)


@pytest.fixture(scope="session")
def movie():
    """The movie domain that comes with the package."""
    from bbq_torchrl.domains import movie_domain

    return movie_domain()


@pytest.fixture(scope="session")
def restaurant_folder():
    """The folder of a small domain of another kind: tables in restaurants."""
    return TESTS / "data" / "restaurant"


@pytest.fixture(scope="session")
def restaurant(restaurant_folder):
    """A small domain of another kind: tables in restaurants."""
    from bbq_torchrl.domains import load_domain

    return load_domain(restaurant_folder)
