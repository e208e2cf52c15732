from __future__ import annotations

from pathlib import Path

import pytest

from bbq_torchrl.domains import load_domain, movie_domain
from bbq_torchrl.language import Understander
from bbq_torchrl.language.lexicon import Lexicon

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="session")
def understand():
    """An understander that has seen few sentences: it knows the plain ones."""
    return Understander.train(movie_domain(), sentences=1_200)


@pytest.fixture(scope="session")
def lexicon():
    return Lexicon(movie_domain())


@pytest.fixture(scope="session")
def restaurant():
    return load_domain(DATA / "restaurant")
