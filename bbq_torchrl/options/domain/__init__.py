"""The options of ``domain=``: what the dialogues are about."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.base import Option
from bbq_torchrl.options.settings import ConfigError

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options.root import Config

__all__ = ["DomainOption"]


@dataclass
class DomainOption(Option):
    """What the dialogues are about."""

    group: ClassVar[str] = "domain"

    def check(self, config: Config) -> None:
        """Refuses a domain beside an environment that has none."""
        if not config.env.has_domain and self.name != "movie":  # the default
            raise ConfigError(
                f"domain must be movie, the default, with env={config.env.name}, which has no "
                f"domain, got {self.name!r}"
            )

    @abstractmethod
    def make(self) -> Domain:
        """Loads the domain.

        Raises:
            ValueError or OSError: the corpus is damaged or not there.
        """
