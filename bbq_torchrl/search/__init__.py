"""A search for hyper-parameters by Optuna: every trial is an ordinary run of ``train.py``.

``python -m bbq_torchrl.search`` is the command; :func:`run_search` does the work.
"""

from __future__ import annotations

from bbq_torchrl.search.study import run_search
from bbq_torchrl.search.trials import Outcome

__all__ = ["Outcome", "run_search"]
