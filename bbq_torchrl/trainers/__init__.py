"""The round trainer: collect dialogues, freeze, learn, freeze, learn."""

from __future__ import annotations

from bbq_torchrl.trainers.checkpoint import (
    CheckpointDamagedError,
    CheckpointFolder,
    CheckpointMismatchError,
    TrainingError,
)
from bbq_torchrl.trainers.collect import (
    EpisodeStats,
    Policy,
    Spike,
    episode_stats,
    rollout,
    rollouts,
)
from bbq_torchrl.trainers.evaluation import (
    BestWeights,
    RoundEvaluator,
    evaluate,
    evaluation_rollouts,
)
from bbq_torchrl.trainers.learn import Learner, ReplicaAdam, losses_of
from bbq_torchrl.trainers.round_trainer import (
    NonFiniteLossError,
    RoundTrainer,
    RunFolderGoneError,
)

__all__ = [
    "BestWeights",
    "CheckpointDamagedError",
    "CheckpointFolder",
    "CheckpointMismatchError",
    "EpisodeStats",
    "Learner",
    "NonFiniteLossError",
    "Policy",
    "ReplicaAdam",
    "RoundEvaluator",
    "RoundTrainer",
    "RunFolderGoneError",
    "Spike",
    "TrainingError",
    "episode_stats",
    "evaluate",
    "evaluation_rollouts",
    "losses_of",
    "rollout",
    "rollouts",
]
