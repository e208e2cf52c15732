"""A search for hyper-parameters by Optuna: every trial is an ordinary run of ``train.py``.

``python -m bbq_torchrl.search`` is the command; :func:`bbq_torchrl.search.study.run_search` does
the work. Nothing here is imported before it is needed: ``--help`` works without Optuna.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bbq_torchrl.search.study import run_search
    from bbq_torchrl.search.trials import Outcome

__all__ = ["Outcome", "run_search"]


def __getattr__(name: str) -> Any:
    if name == "run_search":
        from bbq_torchrl.search.study import run_search

        return run_search
    if name == "Outcome":
        from bbq_torchrl.search.trials import Outcome

        return Outcome
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
