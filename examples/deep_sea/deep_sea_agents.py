"""The agents: each combines a network, an exploration strategy and a loss."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from deep_sea_results import AGENT_NAMES
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import nn
from torchrl.data import Categorical
from torchrl.modules import EGreedyModule

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.data import BootstrapMask
from bbq_torchrl.exploration import BootstrapSampling, Greedy, MajorityVote, ThompsonSampling
from bbq_torchrl.networks import (
    BootstrapMLP,
    FlatMLP,
    GaussianProcess,
    bootstrap_actor,
    q_actor,
)
from bbq_torchrl.networks.gaussian_process import StateFeatures
from bbq_torchrl.objectives import (
    BBQNLoss,
    BootstrapDQNLoss,
    DropoutDQNLoss,
    GPLoss,
    OneStepQLoss,
)
from bbq_torchrl.trainers import ReplicaAdam

sys.path.append(str(Path(__file__).resolve().parents[1] / "extending"))  # for two of the agents

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor
    from torchrl.envs.transforms import Transform

    from bbq_torchrl.bayes.bayes_mlp import MeanInit
    from bbq_torchrl.protocols import ReplicaOptimizer

ACTION = Categorical(2)


@dataclass(frozen=True)
class Settings:
    """The settings of an agent and its training; each agent uses those that apply to it.

    Attributes:
        hidden: sizes of the hidden layers.
        gamma: discount.
        lr: learning rate of Adam.
        batch_size: transitions of a mini-batch.
        updates_per_step: mini-batches per step of a dive.
        freeze_every: mini-batches between copies of the target network.
        capacity: capacity of a replica's memory in transitions.
        eps_end: final ε, the probability of a random action; it starts at 1.
        eps_episodes: episodes over which ε falls.
        prior_std: standard deviation of the prior of BBQN's weights, or "fan_in".
        std_init: initial standard deviation of BBQN's weights; None: the prior's.
        noise_std: standard deviation of BBQN's, or the GP's, observation noise, in units of Q.
        heads: number of bootstrap heads, each a separate network.
        mask_prob: probability that a head learns from a transition; with 1 the heads differ only by
            their initial weights (and their prior functions).
        prior_scale: factor of the bootstrap's, or the epinet's, prior functions.
        index_size: dimensions of the epinet's index.
        inverse_temperature: inverse temperature of Adam LMCDQN's distribution of weights.
    """

    hidden: tuple[int, ...] = (50, 50)
    gamma: float = 0.99
    lr: float = 3e-3
    batch_size: int = 64
    updates_per_step: float = 2.0
    freeze_every: int = 4
    capacity: int = 10_000
    eps_end: float = 0.05
    eps_episodes: int = 100
    prior_std: float | Literal["fan_in"] = 0.1
    std_init: float | None = None
    noise_std: float = 0.03
    heads: int = 10
    mask_prob: float = 1.0
    prior_scale: float = 3.0
    index_size: int = 8
    inverse_temperature: float = 1e8


def default_settings(name: str) -> Settings:
    """Returns an agent's settings in the sweep, chosen by the trials that results/NOTES.md tells.

    BBQN needs more mini-batches: with as few as the other agents it solved N = 8 in no trial. Its
    initial posterior is narrow, except for the paper's, which is the prior. The bootstrap has a
    smaller learning rate: an input of size N makes the steps of the first layer's output N times
    larger. The epinet's initial values must not differ by more than the treasure, and Adam LMCDQN
    needs a temperature at which its noise moves weights in a few thousand steps.
    """
    if name.startswith("bbqn_"):
        return Settings(updates_per_step=4.0, std_init=None if name.endswith("_zero") else 0.03)
    if name == "epinet":
        return Settings(lr=1e-3, updates_per_step=4.0, prior_scale=0.6, index_size=4)
    if name.startswith("gp_"):
        return Settings(prior_std=1.0, noise_std=0.1)
    if name == "langevin":
        return Settings(lr=1e-3, inverse_temperature=100.0)
    return Settings(lr=1e-3) if name.startswith("bootstrap") else Settings()


@dataclass(frozen=True)
class Agent:
    """An agent of R replicas, which act and learn independently.

    Attributes:
        explore: the policy in training.
        greedy: the policy without exploration.
        loss: the loss of a batch of transitions [R, batch].
        begin_dive: called before each dive.
        when_stored: a transform of transitions [R, steps] when they are stored, if any.
        make_optimizer: called with the loss's parameters, R, and the learning rate as ``lr``.
    """

    explore: TensorDictModuleBase
    greedy: TensorDictModuleBase
    loss: OneStepQLoss
    begin_dive: Callable[[], Any]
    when_stored: Transform | None = None
    make_optimizer: Callable[..., ReplicaOptimizer] = ReplicaAdam


def make_agent(name: str, size: int, replicas: int, settings: Settings) -> Agent:
    """Returns an agent for a sea of N x N cells.

    Args:
        name: one of ``AGENT_NAMES``. BBQN's names have the noise of its target; ``_zero``: the
            initial mean of the weights is zero.
        size: N.
        replicas: R, the number of agents trained in parallel.
        settings: the agent's settings.

    Raises:
        ValueError: if the name is unknown.
    """
    if name == "epsilon_greedy":
        return _epsilon_greedy(size, replicas, settings)
    if name in ("bootstrap", "bootstrap_prior"):
        prior_scale = settings.prior_scale if name == "bootstrap_prior" else 0.0
        return _bootstrap(prior_scale, size, replicas, settings)
    if name.startswith("bbqn_"):
        target_noise = name.removeprefix("bbqn_").removesuffix("_zero")
        mean_init = "zero" if name.endswith("_zero") else "kaiming"
        return _bbqn(target_noise, mean_init, size, replicas, settings)
    if name.startswith("gp_"):
        return _gp(name.removeprefix("gp_"), size, replicas, settings)
    if name == "epinet":
        return _epinet(size, replicas, settings)
    if name == "langevin":
        return _langevin(size, replicas, settings)
    raise ValueError(f"agent must be one of {list(AGENT_NAMES)}, got {name!r}")


class Scale(nn.Module):
    """Scales the input of a network.

    A one-hot row of N² cells times N has features of unit mean square. Without it the initial
    weights of an MLP (uniform in ±1/√inputs) tell cells hardly apart beside its biases, and so
    do a bootstrap's prior functions.
    """

    def __init__(self, factor: float) -> None:
        super().__init__()
        self.factor = factor

    def forward(self, x: Tensor) -> Tensor:
        """Returns the input times the factor."""
        return x * self.factor


def _scaled(size: int, network: nn.Module) -> nn.Module:
    return nn.Sequential(Scale(size), network)


def _epsilon_greedy(size: int, replicas: int, settings: Settings) -> Agent:
    network = _scaled(size, FlatMLP(size**2, 2, settings.hidden, replicas=replicas))
    actor = q_actor(network, ACTION, action_mask_key=None)
    dither = EGreedyModule(
        ACTION, eps_init=1.0, eps_end=settings.eps_end, annealing_num_steps=settings.eps_episodes
    )
    return Agent(
        explore=TensorDictSequential(Greedy(actor), dither),
        greedy=Greedy(actor),
        loss=DropoutDQNLoss(actor, gamma=settings.gamma),
        begin_dive=dither.step,
    )


def _bootstrap(prior_scale: float, size: int, replicas: int, settings: Settings) -> Agent:
    network = BootstrapMLP(
        size**2,
        2,
        settings.hidden,
        heads=settings.heads,
        replicas=replicas,
        trunk_layers=0,
        prior_scale=prior_scale,
    )
    actor = bootstrap_actor(_scaled(size, network), ACTION, action_mask_key=None)
    explore = BootstrapSampling(actor, per="round")  # a round is a dive, see begin_dive
    return Agent(
        explore=explore,
        greedy=MajorityVote(actor),
        loss=BootstrapDQNLoss(actor, gamma=settings.gamma),
        begin_dive=explore.resample,
        when_stored=BootstrapMask(settings.heads, settings.mask_prob, replicas=replicas),
    )


def _bbqn(
    target_noise: str, mean_init: MeanInit, size: int, replicas: int, settings: Settings
) -> Agent:
    network = BayesMLP(
        size**2,
        2,
        settings.hidden,
        replicas=replicas,
        prior_std=settings.prior_std,
        mean_init=mean_init,
        std_init=settings.std_init,
    )
    actor = q_actor(_scaled(size, network), ACTION, action_mask_key=None)
    # One draw per dive: only consistent actions can reach the treasure.
    explore = ThompsonSampling(actor, per="round", shared=False)
    return Agent(
        explore=explore,
        greedy=Greedy(actor),
        loss=BBQNLoss(
            actor,
            gamma=settings.gamma,
            noise_std=settings.noise_std,
            kl_temperature=1.0,
            target="map" if target_noise == "mean" else "mc",
            target_noise=target_noise,
        ),
        begin_dive=explore.resample,
    )


def _gp(target: str, size: int, replicas: int, settings: Settings) -> Agent:
    # So short a length that cells are independent, and no value that both actions share.
    features = StateFeatures(size**2, size**2, kernel="rbf", lengthscale=0.2, replicas=replicas)
    network = GaussianProcess(features, 2, prior_std=float(settings.prior_std))
    actor = q_actor(network, ACTION, action_mask_key=None)
    explore = ThompsonSampling(actor, per="round", shared=False)
    loss = GPLoss(
        actor,
        noise_std=settings.noise_std,
        value_std=1e-3,
        sweeps=size,
        target=target,  # type: ignore[arg-type]
        gamma=settings.gamma,
    )
    return Agent(explore=explore, greedy=Greedy(actor), loss=loss, begin_dive=explore.resample)


def _epinet(size: int, replicas: int, settings: Settings) -> Agent:
    from bbq_extending.epinet_mlp import EpinetMLP
    from bbq_extending.index_sampling import INDEX, IndexLoss, IndexSampling

    class ScaledEpinet(EpinetMLP):
        """A network whose input is scaled as the other agents'."""

        def forward(self, x: Tensor, index: Tensor) -> Tensor:
            return super().forward(x * size, index)

    network = ScaledEpinet(
        size**2,
        2,
        settings.hidden,
        index_size=settings.index_size,
        prior_scale=settings.prior_scale,
        replicas=replicas,
    )
    actor = q_actor(network, ACTION, in_keys=("observation", INDEX), action_mask_key=None)
    explore = IndexSampling(actor, settings.index_size)
    return Agent(
        explore=explore,
        greedy=IndexSampling(actor, settings.index_size, explores=False),
        loss=IndexLoss(actor, settings.index_size, gamma=settings.gamma),
        begin_dive=explore.resample,
    )


def _langevin(size: int, replicas: int, settings: Settings) -> Agent:
    from bbq_extending.langevin_adam import LangevinAdam

    network = _scaled(size, FlatMLP(size**2, 2, settings.hidden, replicas=replicas))
    actor = q_actor(network, ACTION, action_mask_key=None)
    return Agent(
        explore=Greedy(actor),  # the weights are a sample
        greedy=Greedy(actor),
        loss=DropoutDQNLoss(actor, gamma=settings.gamma, double_dqn=True),
        begin_dive=lambda: None,
        make_optimizer=partial(LangevinAdam, inverse_temperature=settings.inverse_temperature),
    )
