"""The round trainer: collect dialogues, freeze, learn, freeze, learn."""

from __future__ import annotations

from bbq_torchrl.protocols import EvaluationHook, ReplicaOptimizer, RoundEnv
from bbq_torchrl.trainers.checkpoint import BestWeights, CheckpointFolder
from bbq_torchrl.trainers.collect import (
    EpisodeStats,
    Policy,
    Spike,
    episode_stats,
    rollout,
    rollouts,
)
from bbq_torchrl.trainers.errors import (
    CheckpointDamagedError,
    CheckpointMismatchError,
    NonFiniteLossError,
    NonFiniteWeightsError,
    RunFolderGoneError,
    SpikeError,
    TrainingError,
)
from bbq_torchrl.trainers.learn import Learner, keep_freed_memory, losses_of
from bbq_torchrl.trainers.optimizer import ReplicaAdam
from bbq_torchrl.trainers.recording import MetricRow, MetricsFile, RoundProgress
from bbq_torchrl.trainers.round_trainer import RoundCallback, RoundTrainer
from bbq_torchrl.utils.seeds import derive_seed

__all__ = [
    "BestWeights",
    "CheckpointDamagedError",
    "CheckpointFolder",
    "CheckpointMismatchError",
    "EpisodeStats",
    "EvaluationHook",
    "Learner",
    "MetricRow",
    "MetricsFile",
    "NonFiniteLossError",
    "NonFiniteWeightsError",
    "Policy",
    "ReplicaAdam",
    "ReplicaOptimizer",
    "RoundCallback",
    "RoundEnv",
    "RoundProgress",
    "RoundTrainer",
    "RunFolderGoneError",
    "Spike",
    "SpikeError",
    "TrainingError",
    "derive_seed",
    "episode_stats",
    "keep_freed_memory",
    "losses_of",
    "rollout",
    "rollouts",
]
