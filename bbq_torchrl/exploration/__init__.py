"""Exploration strategies: TensorDict modules that honor the actor's action mask."""

from __future__ import annotations

from bbq_torchrl.exploration.annealed import BatchedEGreedy, Boltzmann
from bbq_torchrl.exploration.base import ActorPolicy, EvaluationPolicy, Greedy
from bbq_torchrl.exploration.bootstrap import BootstrapSampling, MajorityVote
from bbq_torchrl.exploration.thompson import NoisySampling, ThompsonSampling

__all__ = [
    "ActorPolicy",
    "BatchedEGreedy",
    "Boltzmann",
    "BootstrapSampling",
    "EvaluationPolicy",
    "Greedy",
    "MajorityVote",
    "NoisySampling",
    "ThompsonSampling",
]
