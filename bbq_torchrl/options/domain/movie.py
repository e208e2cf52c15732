"""``domain=movie``: the corpus that ships with the package."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bbq_torchrl.options import DomainOption, register
from bbq_torchrl.options.settings import option

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain


@register
@dataclass
class MovieDomain(DomainOption):
    """The movie-booking corpus that ships with the package."""

    name: str = option("movie")

    def make(self) -> Domain:
        """Loads it."""
        from bbq_torchrl.domains import movie_domain

        return movie_domain()
