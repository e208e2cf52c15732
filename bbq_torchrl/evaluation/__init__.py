"""Measuring trained agents: dialogues, statistics over seeds, tables and figures."""

from __future__ import annotations

from bbq_torchrl.evaluation.results import (
    Metrics,
    ReplicaResult,
    RunResult,
    read_metrics,
    read_result,
)
from bbq_torchrl.evaluation.statistics import (
    Estimate,
    binomial_standard_error,
    estimate,
    interquartile_mean,
    probability_of_improvement,
)

__all__ = [
    "Estimate",
    "Metrics",
    "ReplicaResult",
    "RunResult",
    "binomial_standard_error",
    "estimate",
    "interquartile_mean",
    "probability_of_improvement",
    "read_metrics",
    "read_result",
]
