"""Hyper-parameter search by Optuna: every trial is an ordinary run of ``train.py``.

The command is ``bbq search``; :func:`bbq_torchrl.search.trials.run_search` does the work.
``--help`` works without Optuna.
"""
