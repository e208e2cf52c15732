from __future__ import annotations

import pytest

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.people.language import Understander
from bbq_torchrl.people.language.lexicon import Lexicon


@pytest.fixture(scope="session")
def understand():
    """An understander that has seen few sentences: it knows the plain ones."""
    return Understander.train(movie_domain(), sentences=1_200)


@pytest.fixture(scope="session")
def lexicon():
    return Lexicon(movie_domain())
