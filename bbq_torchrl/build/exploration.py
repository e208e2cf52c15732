"""How an agent acts while it learns: a policy for each option of ``explore=``."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torchrl.modules import EGreedyModule

from bbq_torchrl.build.values import over_replicas
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
from bbq_torchrl.modules import (
    BatchedEGreedy,
    Boltzmann,
    BootstrapSampling,
    NoisySampling,
    ThompsonSampling,
)

if TYPE_CHECKING:
    from torchrl.data import TensorSpec

    from bbq_torchrl.build.parts import AgentParts
    from bbq_torchrl.config.settings import Values

__all__ = ["exploring_policy"]

Policy = tuple[TensorDictModuleBase, dict[str, Callable[[], float | Tensor]]]


def exploring_policy(
    config: ExploreConfig, parts: AgentParts, spec: TensorSpec, replicas: int, rounds: int
) -> Policy:
    """Returns the policy that explores, and its gauges: what of it is worth a metric.

    Args:
        config: an option of ``explore``; whether the agent can use it has been checked.
        parts: the agent's.
        spec: of one action.
        replicas: the first dimension of the batch that is acted on; the other one is dialogues.
        rounds: of the training, which schedules take a share of.
    """
    return _POLICIES[type(config)](config, parts, spec, replicas, rounds)


def _annealed_rounds(
    config: EpsilonGreedyConfig | ThompsonEpsilonConfig | BoltzmannConfig, rounds: int
) -> int:
    """Returns the length of a schedule; a share of 0 is over after the first round."""
    return max(1, round(config.anneal_fraction * rounds))


def _beside_dialogues(value: Values, replicas: int) -> float | Tensor:
    """Returns one number as it is, and a list as [replicas, 1]."""
    over = over_replicas(value, replicas)
    return over.unsqueeze(-1) if isinstance(over, Tensor) else over


def _greedy(
    config: GreedyConfig, parts: AgentParts, spec: TensorSpec, replicas: int, rounds: int
) -> Policy:
    return parts.greedy, {}


def _thompson(
    config: ThompsonConfig, parts: AgentParts, spec: TensorSpec, replicas: int, rounds: int
) -> Policy:
    return ThompsonSampling(parts.actor, per=config.per, shared=config.shared), {}  # type: ignore[arg-type]


def _epsilon_greedy(
    config: EpsilonGreedyConfig | ThompsonEpsilonConfig,
    parts: AgentParts,
    spec: TensorSpec,
    replicas: int,
    rounds: int,
) -> Policy:
    base = parts.greedy
    if isinstance(config, ThompsonEpsilonConfig):
        base = ThompsonSampling(parts.actor, per=config.per, shared=config.shared)  # type: ignore[arg-type]
    start, end = (_beside_dialogues(value, replicas) for value in (config.eps_init, config.eps_end))
    has_several = isinstance(start, Tensor) or isinstance(end, Tensor)
    epsilon = (BatchedEGreedy if has_several else EGreedyModule)(
        spec,
        eps_init=start,
        eps_end=end,
        annealing_num_steps=_annealed_rounds(config, rounds),
        action_mask_key="action_mask",
    )
    return TensorDictSequential(base, epsilon), {"epsilon": lambda: epsilon.eps.squeeze(-1)}


def _boltzmann(
    config: BoltzmannConfig, parts: AgentParts, spec: TensorSpec, replicas: int, rounds: int
) -> Policy:
    boltzmann = Boltzmann(
        _beside_dialogues(config.temperature_init, replicas),
        _beside_dialogues(config.temperature_end, replicas),
        _annealed_rounds(config, rounds),
    )
    return (
        TensorDictSequential(parts.greedy, boltzmann),
        {"temperature": lambda: boltzmann.temperature.squeeze(-1)},
    )


def _bootstrap(
    config: BootstrapSamplingConfig, parts: AgentParts, spec: TensorSpec, replicas: int, rounds: int
) -> Policy:
    return BootstrapSampling(parts.actor, per=config.per), {}  # type: ignore[arg-type]


def _noisy(
    config: NoisyConfig, parts: AgentParts, spec: TensorSpec, replicas: int, rounds: int
) -> Policy:
    return NoisySampling(parts.actor, shared=config.shared), {}


_POLICIES: dict[type[ExploreConfig], Callable[[Any, AgentParts, TensorSpec, int, int], Policy]] = {
    GreedyConfig: _greedy,
    ThompsonConfig: _thompson,
    ThompsonEpsilonConfig: _epsilon_greedy,
    EpsilonGreedyConfig: _epsilon_greedy,
    BoltzmannConfig: _boltzmann,
    BootstrapSamplingConfig: _bootstrap,
    NoisyConfig: _noisy,
}
