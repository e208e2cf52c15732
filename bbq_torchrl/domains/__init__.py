"""Domains: the subject of a dialogue as data, checked by a loader and turned into tensors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.domain import REQUIRED_ACTS, Action, Domain, Goal, ScriptedPolicySpec
from bbq_torchrl.domains.folder import load_domain, movie_domain, save_data, shipped_domain
from bbq_torchrl.domains.miulab import load_miulab
from bbq_torchrl.domains.values import (
    AVAILABLE,
    DONT_CARE,
    FIRST_VALUE,
    NO_MATCH,
    NONE,
    RESERVED_TEXT,
    fold,
)

if TYPE_CHECKING:
    from bbq_torchrl.domains.tensors import DomainTensors, build_vocabulary, tensorize

__all__ = [
    "AVAILABLE",
    "DONT_CARE",
    "FIRST_VALUE",
    "NONE",
    "NO_MATCH",
    "REQUIRED_ACTS",
    "RESERVED_TEXT",
    "Action",
    "Domain",
    "DomainTensors",
    "Goal",
    "ScriptedPolicySpec",
    "build_vocabulary",
    "fold",
    "load_domain",
    "load_miulab",
    "movie_domain",
    "save_data",
    "shipped_domain",
    "tensorize",
]


def __getattr__(name: str) -> Any:
    # Imported on first use: only tensors need torch, which takes seconds to import.
    if name in ("DomainTensors", "build_vocabulary", "tensorize"):
        from bbq_torchrl.domains import tensors

        return getattr(tensors, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
