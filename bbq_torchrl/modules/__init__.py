"""Bayesian layers, Q-networks and exploration: TensorDict modules that know no dialogue."""

from bbq_torchrl.modules.annealed import BatchedEGreedy, Boltzmann
from bbq_torchrl.modules.bayes_mlp import BayesLinear, BayesMLP
from bbq_torchrl.modules.bootstrap import BootstrapMLP
from bbq_torchrl.modules.dynamics import DynamicsModel
from bbq_torchrl.modules.evaluation_policy import EvaluationPolicy
from bbq_torchrl.modules.exploration import Greedy, ThompsonSampling
from bbq_torchrl.modules.functional import FlatLayout
from bbq_torchrl.modules.growth import grow, reset_inactive_
from bbq_torchrl.modules.heads import BootstrapSampling, MajorityVote
from bbq_torchrl.modules.held_std import held_std
from bbq_torchrl.modules.information_gain import information_gain, mlp_information_gain
from bbq_torchrl.modules.kl import collect_kl, kl_divergence
from bbq_torchrl.modules.mlp import MLP
from bbq_torchrl.modules.noise_pool import noise_pool
from bbq_torchrl.modules.noisy import NoisyMLP, NoisySampling, StackedNoisyLinear
from bbq_torchrl.modules.posterior import GaussianPosterior
from bbq_torchrl.modules.q_network import q_network
from bbq_torchrl.modules.scripted import CarefulPolicy, RandomPolicy, SequencePolicy
from bbq_torchrl.modules.shared_noise import shared_noise
from bbq_torchrl.modules.vote import VoteModule, bootstrap_actor
from bbq_torchrl.modules.weight_mode import (
    given_weights,
    resolve_weight_mode,
    set_weight_mode,
    weight_mode,
)

__all__ = [
    "MLP",
    "BatchedEGreedy",
    "BayesLinear",
    "BayesMLP",
    "Boltzmann",
    "BootstrapMLP",
    "BootstrapSampling",
    "CarefulPolicy",
    "DynamicsModel",
    "EvaluationPolicy",
    "FlatLayout",
    "GaussianPosterior",
    "Greedy",
    "MajorityVote",
    "NoisyMLP",
    "NoisySampling",
    "RandomPolicy",
    "SequencePolicy",
    "StackedNoisyLinear",
    "ThompsonSampling",
    "VoteModule",
    "bootstrap_actor",
    "collect_kl",
    "given_weights",
    "grow",
    "held_std",
    "information_gain",
    "kl_divergence",
    "mlp_information_gain",
    "noise_pool",
    "q_network",
    "reset_inactive_",
    "resolve_weight_mode",
    "set_weight_mode",
    "shared_noise",
    "weight_mode",
]
