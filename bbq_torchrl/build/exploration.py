"""How an agent acts while it learns: a policy for each option of ``explore=``."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.modules import EGreedyModule

from bbq_torchrl.config.explorations import (
    BoltzmannConfig,
    BootstrapSamplingConfig,
    EpsilonGreedyConfig,
    ExploreConfig,
    GreedyConfig,
    NoisyConfig,
    ThompsonConfig,
    ThompsonEpsilonConfig,
)
from bbq_torchrl.modules import Boltzmann, BootstrapSampling, NoisySampling, ThompsonSampling

if TYPE_CHECKING:
    from torchrl.data import TensorSpec

    from bbq_torchrl.build.parts import AgentParts

__all__ = ["exploring_policy"]

Policy = tuple[TensorDictModuleBase, dict[str, Callable[[], float]]]


def exploring_policy(config: ExploreConfig, parts: AgentParts, spec: TensorSpec) -> Policy:
    """Returns the policy that explores, and its gauges: what of it is worth a metric.

    Args:
        config: an option of ``explore``; whether the agent can use it has been checked.
        parts: the agent's.
        spec: of one action.
    """
    return _POLICIES[type(config)](config, parts, spec)


def _greedy(config: GreedyConfig, parts: AgentParts, spec: TensorSpec) -> Policy:
    return parts.greedy, {}


def _thompson(config: ThompsonConfig, parts: AgentParts, spec: TensorSpec) -> Policy:
    return ThompsonSampling(parts.actor, per=config.per, shared=config.shared), {}  # type: ignore[arg-type]


def _epsilon_greedy(
    config: EpsilonGreedyConfig | ThompsonEpsilonConfig, parts: AgentParts, spec: TensorSpec
) -> Policy:
    base = parts.greedy
    if isinstance(config, ThompsonEpsilonConfig):
        base = ThompsonSampling(parts.actor, per=config.per, shared=config.shared)  # type: ignore[arg-type]
    epsilon = EGreedyModule(
        spec,
        eps_init=config.eps_init,
        eps_end=config.eps_end,
        annealing_num_steps=config.anneal_rounds,
        action_mask_key="action_mask",
    )
    return TensorDictSequential(base, epsilon), {"epsilon": lambda: float(epsilon.eps)}


def _boltzmann(config: BoltzmannConfig, parts: AgentParts, spec: TensorSpec) -> Policy:
    boltzmann = Boltzmann(config.temperature_init, config.temperature_end, config.anneal_rounds)
    return (
        TensorDictSequential(parts.greedy, boltzmann),
        {"temperature": lambda: float(boltzmann.temperature)},
    )


def _bootstrap(config: BootstrapSamplingConfig, parts: AgentParts, spec: TensorSpec) -> Policy:
    return BootstrapSampling(parts.actor, per=config.per), {}  # type: ignore[arg-type]


def _noisy(config: NoisyConfig, parts: AgentParts, spec: TensorSpec) -> Policy:
    return NoisySampling(parts.actor, shared=config.shared), {}


_POLICIES: dict[type[ExploreConfig], Callable[[Any, AgentParts, TensorSpec], Policy]] = {
    GreedyConfig: _greedy,
    ThompsonConfig: _thompson,
    ThompsonEpsilonConfig: _epsilon_greedy,
    EpsilonGreedyConfig: _epsilon_greedy,
    BoltzmannConfig: _boltzmann,
    BootstrapSamplingConfig: _bootstrap,
    NoisyConfig: _noisy,
}
