"""``domain=folder``: a domain of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bbq_torchrl.options import DomainOption, register
from bbq_torchrl.options.settings import ANY_TEXT, REQUIRED, option, setting

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain


@register
@dataclass
class FolderDomain(DomainOption):
    """A domain folder: domain.yaml, knowledge_base.csv, goals.jsonl, values.json."""

    name: str = option("folder")
    path: str = setting(REQUIRED, ANY_TEXT, "the folder")

    def make(self) -> Domain:
        """Loads and validates it."""
        from bbq_torchrl.domains import load_domain

        return load_domain(self.path)
