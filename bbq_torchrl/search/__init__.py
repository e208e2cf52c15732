"""A search for hyper-parameters by Optuna: every trial is an ordinary run of ``train.py``.

``python -m bbq_torchrl.search`` is the command; :func:`bbq_torchrl.search.study.run_search` does
the work. Nothing here is imported before it is needed: ``--help`` works without Optuna.
"""
