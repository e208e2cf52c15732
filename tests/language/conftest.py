from __future__ import annotations

from pathlib import Path

import pytest

from bbq_torchrl.domains import load_domain, movie_domain
from bbq_torchrl.domains.folder import MOVIE_FOLDER
from bbq_torchrl.language import Understander

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="session")
def understand():
    """An understander that has seen few sentences: it knows the plain ones."""
    return Understander.train(movie_domain(), MOVIE_FOLDER, sentences=1_200)


@pytest.fixture(scope="session")
def restaurant():
    return load_domain(DATA / "restaurant")
