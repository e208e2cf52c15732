"""The options of ``domain=``: what the dialogues are about."""

from __future__ import annotations

import os
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

    def resolve_path(self) -> None:
        """Makes the key ``path`` absolute, where there is one: a run may go on elsewhere."""
        if path := getattr(self, "path", ""):
            self.path = os.path.abspath(os.path.expanduser(path))

    def make(self) -> Domain:
        """Loads the domain.

        Raises:
            ValueError or OSError: the corpus is damaged or not there.
        """
        raise NotImplementedError
