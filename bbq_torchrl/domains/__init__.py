"""Domains: the subject of a dialogue as data, checked by a loader and turned into tensors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.domain import Action, Domain, Goal, ScriptedPolicySpec
from bbq_torchrl.domains.folder import load_domain, movie_domain, shipped_domain
from bbq_torchrl.domains.miulab import load_miulab
from bbq_torchrl.domains.values import fold

if TYPE_CHECKING:
    from bbq_torchrl.domains.tensors import DomainTensors, build_vocabulary, tensorize

__all__ = [
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
    "shipped_domain",
    "tensorize",
]


def __getattr__(name: str) -> Any:
    # Imported on first use: only tensors need torch, which takes seconds to import.
    if name in ("DomainTensors", "build_vocabulary", "tensorize"):
        from bbq_torchrl.domains import tensors

        return getattr(tensors, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
