"""The options of ``domain=``: what the dialogues are about."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.base import Option

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain

__all__ = ["DomainOption"]


@dataclass
class DomainOption(Option):
    """What the dialogues are about."""

    group: ClassVar[str] = "domain"

    @abstractmethod
    def make(self) -> Domain:
        """Loads the domain.

        Raises:
            ValueError or OSError: the corpus is damaged or not there.
        """
