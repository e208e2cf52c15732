"""Evaluation of trained agents: dialogues, statistics over seeds, tables and figures."""

from __future__ import annotations

from bbq_torchrl.evaluation.curves import Metrics, areas, read_metrics, rounds_to_reach
from bbq_torchrl.evaluation.run_result import (
    ReplicaResult,
    RunResult,
    TrainingEvaluation,
    read_result,
)
from bbq_torchrl.utils.statistics import (
    Estimate,
    binomial_standard_error,
    estimate,
    estimate_iqm,
    interquartile_mean,
)

__all__ = [
    "Estimate",
    "Metrics",
    "ReplicaResult",
    "RunResult",
    "TrainingEvaluation",
    "areas",
    "binomial_standard_error",
    "estimate",
    "estimate_iqm",
    "interquartile_mean",
    "read_metrics",
    "read_result",
    "rounds_to_reach",
]
