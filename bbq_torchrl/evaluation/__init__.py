"""Measuring trained agents: dialogues, statistics over seeds, tables and figures."""

from __future__ import annotations

from bbq_torchrl.evaluation.learning import areas, rounds_to_reach
from bbq_torchrl.evaluation.metrics import Metrics, read_metrics
from bbq_torchrl.evaluation.results import (
    ReplicaResult,
    RunResult,
    TrainingEvaluation,
    read_result,
)
from bbq_torchrl.evaluation.statistics import (
    Estimate,
    Summary,
    binomial_standard_error,
    estimate,
    interquartile_mean,
    paired_differences,
    probability_of_improvement,
    summarize,
)

__all__ = [
    "Estimate",
    "Metrics",
    "ReplicaResult",
    "RunResult",
    "Summary",
    "TrainingEvaluation",
    "areas",
    "binomial_standard_error",
    "estimate",
    "interquartile_mean",
    "paired_differences",
    "probability_of_improvement",
    "read_metrics",
    "read_result",
    "rounds_to_reach",
    "summarize",
]
