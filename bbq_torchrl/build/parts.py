"""Network, loss and greedy policies for each option of ``agent=``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tensordict.nn import TensorDictModuleBase

from bbq_torchrl.build.values import over_replicas
from bbq_torchrl.config.agents import AgentConfig, BBQNConfig, BootstrapConfig, DQNConfig
from bbq_torchrl.config.settings import ConfigError
from bbq_torchrl.data import BootstrapMask
from bbq_torchrl.modules import (
    MLP,
    BayesMLP,
    BootstrapMLP,
    EvaluationPolicy,
    Greedy,
    MajorityVote,
    NoisyMLP,
    bootstrap_actor,
    q_network,
    reset_inactive_,
)
from bbq_torchrl.objectives import BBQNLoss, BootstrapDQNLoss, DropoutDQNLoss, NoisyDQNLoss

if TYPE_CHECKING:
    from collections.abc import Callable

    import torch
    from torch import Tensor
    from torchrl.data import TensorSpec
    from torchrl.envs import Transform
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

    from bbq_torchrl.config.settings import Values

__all__ = ["AgentParts", "Surroundings", "agent_parts"]

Evaluation = tuple[str, TensorDictModuleBase]


@dataclass(frozen=True)
class Surroundings:
    """What an agent's network has to fit.

    Attributes:
        inputs: features of an observation.
        spec: of one action.
        stack: leading shape of the weights: the replicas.
        inactive_inputs: bool [inputs], features that come into use later (None: there are none).
        inactive_actions: bool [actions], the same of actions.
        device: of the weights.
    """

    inputs: int
    spec: TensorSpec
    stack: tuple[int, ...]
    inactive_inputs: Tensor | None
    inactive_actions: Tensor | None
    device: torch.device | None

    @property
    def replicas(self) -> int:
        """Independent seeds trained side by side."""
        return self.stack[0]


@dataclass(frozen=True)
class AgentParts:
    """What every agent consists of.

    Attributes:
        actor: the Q-network and its choice of an action.
        loss: what is learned.
        greedy: acts without exploration.
        evaluation: a mode (or None for the agent's own) to the name of the policy that is to be
            reported, and that policy.
        transforms: what the replay buffer has to do for the agent.
    """

    actor: QValueActor
    loss: LossModule
    greedy: TensorDictModuleBase
    evaluation: Callable[[str | None], Evaluation]
    transforms: tuple[Transform, ...] = ()


def agent_parts(config: AgentConfig, around: Surroundings) -> AgentParts:
    """Makes the parts of an agent; weights are drawn from torch's global generator.

    What the domain extension has not activated yet starts as if it were added only later
    (:func:`~bbq_torchrl.modules.reset_inactive_`).
    """
    return _PARTS[type(config)](config, around)


def _bbqn(config: BBQNConfig, around: Surroundings) -> AgentParts:
    def value(given: Values) -> float | Tensor:
        return over_replicas(given, around.replicas)

    network = BayesMLP(
        around.inputs,
        around.spec.n,
        config.hidden,
        stack=around.stack,
        prior_std="fan_in" if config.prior_std == "fan_in" else value(config.prior_std),
        mean_init=config.mean_init,  # type: ignore[arg-type]
        std_init=None if config.std_init is None else value(config.std_init),
        device=around.device,
    )
    actor = _actor(network, around)
    loss = BBQNLoss(
        actor,
        target=config.target,  # type: ignore[arg-type]
        target_noise=config.target_noise,  # type: ignore[arg-type]
        kl=config.kl,  # type: ignore[arg-type]
        noise_std=value(config.noise_std),
        kl_temperature=value(config.kl_temperature),
        gamma=value(config.gamma),
        hold=True,
    )

    def evaluation(mode: str | None) -> Evaluation:
        name = config.evaluate if mode is None else mode
        return name, EvaluationPolicy(actor, mode=name, num_draws=config.evaluate_draws)  # type: ignore[arg-type]

    return AgentParts(actor, loss, Greedy(actor), evaluation)


def _dqn(config: DQNConfig, around: Surroundings) -> AgentParts:
    sizes = (around.inputs, around.spec.n, config.hidden)
    network: MLP | NoisyMLP
    if config.noisy:
        network = NoisyMLP(*sizes, stack=around.stack, device=around.device)
    else:
        network = MLP(*sizes, stack=around.stack, dropout=config.dropout, device=around.device)
    actor = _actor(network, around)
    gamma = over_replicas(config.gamma, around.replicas)
    loss: DropoutDQNLoss | NoisyDQNLoss
    if config.noisy:
        loss = NoisyDQNLoss(actor, gamma=gamma, double_dqn=config.double)
    else:
        loss = DropoutDQNLoss(actor, gamma=gamma, double_dqn=config.double, hold=True)
    greedy = Greedy(actor)
    return AgentParts(actor, loss, greedy, _only(config, "greedy", greedy))


def _bootstrap(config: BootstrapConfig, around: Surroundings) -> AgentParts:
    network = BootstrapMLP(
        around.inputs,
        around.spec.n,
        config.hidden,
        heads=config.heads,
        stack=around.stack,
        trunk_layers=config.trunk_layers,
        prior_scale=config.prior_scale,
        device=around.device,
    )
    _reset_inactive(network, around)
    actor = bootstrap_actor(network, around.spec)
    gamma = over_replicas(config.gamma, around.replicas)
    loss = BootstrapDQNLoss(actor, gamma=gamma, double_dqn=config.double)
    vote = MajorityVote(actor)
    mask = BootstrapMask(config.heads, config.mask_prob, stack=around.stack)
    return AgentParts(actor, loss, vote, _only(config, "vote", vote), (mask,))


def _only(
    config: AgentConfig, name: str, policy: TensorDictModuleBase
) -> Callable[[str | None], Evaluation]:
    """Returns the evaluation of an agent that has one policy to report and no modes."""

    def evaluation(mode: str | None) -> Evaluation:
        if mode is not None:
            raise ConfigError(f"mode must be null for agent={config.name}, got {mode!r}")
        return name, policy

    return evaluation


def _actor(network: Any, around: Surroundings) -> QValueActor:
    _reset_inactive(network, around)
    return q_network(network, around.spec)


def _reset_inactive(network: Any, around: Surroundings) -> None:
    if around.inactive_inputs is not None or around.inactive_actions is not None:
        reset_inactive_(network, inputs=around.inactive_inputs, outputs=around.inactive_actions)


_PARTS: dict[type[AgentConfig], Callable[[Any, Surroundings], AgentParts]] = {
    BBQNConfig: _bbqn,
    DQNConfig: _dqn,
    BootstrapConfig: _bootstrap,
}
