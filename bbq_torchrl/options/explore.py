"""The options of ``explore=``: the policy that acts while the agent learns."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.options.task import annealed_rounds, check_falls, replica_column
from bbq_torchrl.settings import (
    BOOLEAN,
    POSITIVE,
    PROBABILITY,
    Values,
    one_of,
    option,
    other_default,
    per_replica,
    setting,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor
    from torchrl.modules import QValueActor

    from bbq_torchrl.options.task import Task


ExploreMetrics = dict[str, "Callable[[], float | Tensor]"]
"""Functions that return metrics by name, as one number or [replicas]."""

Exploration = tuple["TensorDictModuleBase", ExploreMetrics]
"""A policy and its metrics."""


@dataclass
class ExploreOption(Option):
    """The policy that acts while the agent learns.

    Attributes:
        requires: the features that an agent must provide (:attr:`AgentOption.provides`).
    """

    group: ClassVar[str] = "explore"

    uniform_first: bool = setting(False, BOOLEAN, "play at random until a replica's first success")

    requires: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """Makes the policy and its metrics.

        Args:
            actor: the agent's Q-network with its choice of an action.
            greedy: the agent's policy without exploration.
            task: the task; the policy acts on batches [replicas, dialogues].
        """

    def begin_uniformly(
        self, policy: TensorDictModuleBase, metrics: ExploreMetrics, task: Task
    ) -> Exploration:
        """Returns the policy and metrics of :meth:`make`, with uniform play first if so set."""
        if not self.uniform_first:
            return policy, metrics
        from tensordict.nn import TensorDictSequential

        from bbq_torchrl.exploration.annealed import UniformUntilSuccess

        first = UniformUntilSuccess(
            task.action_spec, task.replicas, action_mask_key=task.action_mask_key
        )
        return TensorDictSequential(policy, first), {
            **metrics,
            "uniform": lambda: first.eps.squeeze(-1),
        }


@register
@dataclass
class GreedyActing(ExploreOption):
    """The action of the highest Q-value; no exploration."""

    name: str = option("greedy")

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The agent's policy without exploration."""
        return greedy, {}


@register
@dataclass
class EpsilonGreedy(ExploreOption):
    """The greedy action, or with probability epsilon a uniformly random legal one."""

    name: str = option("epsilon_greedy")
    eps_init: Values = setting(0.04, per_replica(PROBABILITY), "epsilon in the first round")
    eps_end: Values = setting(0.01, per_replica(PROBABILITY), "epsilon after annealing")
    anneal_fraction: float = setting(0.5, PROBABILITY, "share of the rounds in which epsilon falls")

    def check(self) -> None:
        """Refuses an epsilon that rises."""
        check_falls(self, "eps_init", "eps_end")

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The policy, followed by a module that replaces its action."""
        from tensordict.nn import TensorDictSequential
        from torch import Tensor
        from torchrl.modules import EGreedyModule

        from bbq_torchrl.exploration import BatchedEGreedy

        start, end = (replica_column(value, task) for value in (self.eps_init, self.eps_end))
        has_several = isinstance(start, Tensor) or isinstance(end, Tensor)
        epsilon = (BatchedEGreedy if has_several else EGreedyModule)(
            task.action_spec,
            eps_init=start,
            eps_end=end,
            annealing_num_steps=annealed_rounds(self.anneal_fraction, task),
            action_mask_key=task.action_mask_key,
        )
        return TensorDictSequential(greedy, epsilon), {"epsilon": lambda: epsilon.eps.squeeze(-1)}


@register
@dataclass
class BoltzmannActing(ExploreOption):
    """Actions drawn from softmax(Q / temperature)."""

    name: str = option("boltzmann")
    temperature_init: Values = setting(0.7, per_replica(POSITIVE), "first temperature, units of Q")
    temperature_end: Values = setting(0.7, per_replica(POSITIVE), "temperature after annealing")
    anneal_fraction: float = setting(0.5, PROBABILITY, "share of the rounds in which it falls")

    requires: ClassVar[tuple[str, ...]] = ("values",)

    def check(self) -> None:
        """Refuses a temperature that rises."""
        check_falls(self, "temperature_init", "temperature_end")

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The policy, which writes the values, and a module that draws an action from them."""
        from tensordict.nn import TensorDictSequential

        from bbq_torchrl.exploration import Boltzmann

        boltzmann = Boltzmann(
            replica_column(self.temperature_init, task),
            replica_column(self.temperature_end, task),
            annealed_rounds(self.anneal_fraction, task),
            action_mask_key=task.action_mask_key,
        )
        return (
            TensorDictSequential(greedy, boltzmann),
            {"temperature": lambda: boltzmann.temperature.squeeze(-1)},
        )


@register
@dataclass
class Thompson(ExploreOption):
    """Draw weights from the posterior and act greedily on them."""

    name: str = option("thompson")
    per: str = setting("step", one_of("step", "episode", "round"), "duration of a weight draw")
    shared: bool = setting(False, BOOLEAN, "one draw for all parallel dialogues")

    requires: ClassVar[tuple[str, ...]] = ("posterior",)

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws weights."""
        from bbq_torchrl.exploration import ThompsonSampling

        return ThompsonSampling(actor, per=self.per, shared=self.shared), {}  # type: ignore[arg-type]


class _OnWeightDraws:
    """A strategy on the values of a weight draw; precedes that strategy and Thompson."""

    requires: ClassVar[tuple[str, ...]] = Thompson.requires

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws weights, followed by the strategy's module."""
        policy, _ = Thompson.make(self, actor, greedy, task)  # type: ignore[arg-type]
        return super().make(actor, policy, task)  # type: ignore[misc]


@register
@dataclass
class ThompsonEpsilon(_OnWeightDraws, EpsilonGreedy, Thompson):
    """Thompson sampling, or with probability epsilon a uniformly random legal action."""

    name: str = option("thompson_epsilon")


@register
@dataclass
class ThompsonBoltzmann(_OnWeightDraws, BoltzmannActing, Thompson):
    """Actions drawn from softmax(Q / temperature) of a weight draw."""

    name: str = option("thompson_boltzmann")
    temperature_end: Values = other_default(BoltzmannActing, "temperature_end", 0.05)


@register
@dataclass
class BootstrapActing(ExploreOption):
    """Act greedily on one of the heads, drawn for every dialogue."""

    name: str = option("bootstrap")
    per: str = setting("episode", one_of("step", "episode", "round"), "duration of a head draw")

    requires: ClassVar[tuple[str, ...]] = ("heads",)

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws a head."""
        from bbq_torchrl.exploration import BootstrapSampling

        return BootstrapSampling(actor, per=self.per), {}  # type: ignore[arg-type]


@register
@dataclass
class NoisyActing(ExploreOption):
    """Act greedily on a draw of the NoisyNet's noise in each step."""

    name: str = option("noisy")
    shared: bool = setting(False, BOOLEAN, "one draw for all parallel dialogues")

    requires: ClassVar[tuple[str, ...]] = ("noise",)

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws noise."""
        from bbq_torchrl.exploration import NoisySampling

        return NoisySampling(actor, shared=self.shared), {}
