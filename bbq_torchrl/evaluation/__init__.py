"""Evaluation of trained agents: dialogues, statistics over seeds, tables and figures."""

from __future__ import annotations

from bbq_torchrl.evaluation.curves import Metrics, areas, booked, read_metrics, rounds_to_reach
from bbq_torchrl.evaluation.groups import Group, Pairing, pair, read_groups
from bbq_torchrl.evaluation.run_result import (
    ReplicaResult,
    RunResult,
    TrainingEvaluation,
    read_result,
)

__all__ = [
    "Group",
    "Metrics",
    "Pairing",
    "ReplicaResult",
    "RunResult",
    "TrainingEvaluation",
    "areas",
    "booked",
    "pair",
    "read_groups",
    "read_metrics",
    "read_result",
    "rounds_to_reach",
]
