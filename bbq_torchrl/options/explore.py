"""The options of ``explore=``, the policy of a learning agent, and ``intrinsic=``, a reward."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.options.task import keywords, replica_column, spread
from bbq_torchrl.settings import (
    BOOLEAN,
    COUNT,
    COUNTS,
    NON_NEGATIVE,
    POSITIVE,
    PROBABILITY,
    ConfigError,
    Values,
    integers,
    one_of,
    option,
    other_default,
    per_replica,
    setting,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor, nn
    from torchrl.envs import Transform
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

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

    requires: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """Makes the policy and its metrics.

        Args:
            actor: the agent's Q-network with its choice of an action.
            greedy: the agent's policy without exploration.
            task: the task; the policy acts on batches [replicas, dialogues].
        """


@register
@dataclass
class GreedyActing(ExploreOption):
    """The action of the highest Q-value; no exploration."""

    name: str = option("greedy")

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The agent's policy without exploration."""
        return greedy, {}


@dataclass
class AnnealedOption(ExploreOption):
    """A strategy with a number that falls from its start to its end.

    Attributes:
        falls: the keys of the start and of the end.
    """

    falls: ClassVar[tuple[str, str]]

    anneal_by: str = setting(
        "rounds", one_of("rounds", "success"), "what it falls with: rounds or a replica's success"
    )
    anneal_fraction: float = setting(
        0.5, PROBABILITY, "share of the rounds, or mean success, at which the end is reached"
    )

    def check(self) -> None:
        """Refuses a fall over no success, and a number that rises for any replica."""
        if self.anneal_by == "success" and not self.anneal_fraction:
            raise ConfigError(
                "explore.anneal_fraction must be above 0 with explore.anneal_by=success, got "
                f"{self.anneal_fraction:g}"
            )
        (first, last), (start, end) = self.falls, (getattr(self, key) for key in self.falls)
        # All numbers of replicas that both lengths divide give the same pairs.
        both = (len(value) if isinstance(value, list) else 1 for value in (start, end))
        replicas = math.lcm(*both)
        pairs = zip(spread(start, replicas), spread(end, replicas), strict=True)
        if any(before < after for before, after in pairs):
            raise ConfigError(
                f"explore.{first} must be at least explore.{last} ({end}), got {start}"
            )

    def schedule(self, task: Task) -> tuple[float | Tensor, float | Tensor, dict[str, Any]]:
        """Returns start, end and the schedule's keywords for an exploration module."""
        first, last = (replica_column(getattr(self, key), task) for key in self.falls)
        if self.anneal_by == "rounds":
            rounds = max(1, round(self.anneal_fraction * task.rounds))
            return first, last, {"annealing_num_steps": rounds}
        import torch

        column = torch.zeros(task.replicas, 1) + first
        return column, last, {"until_success": self.anneal_fraction}


@register
@dataclass
class EpsilonGreedy(AnnealedOption):
    """The greedy action, or with probability epsilon a uniformly random legal one."""

    name: str = option("epsilon_greedy")
    eps_init: Values = setting(0.04, per_replica(PROBABILITY), "epsilon in the first round")
    eps_end: Values = setting(0.01, per_replica(PROBABILITY), "epsilon after annealing")

    falls: ClassVar[tuple[str, str]] = ("eps_init", "eps_end")

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The policy, followed by a module that replaces its action."""
        from tensordict.nn import TensorDictSequential

        from bbq_torchrl.exploration import BatchedEGreedy

        start, end, fall = self.schedule(task)
        spec, mask = task.action_spec, task.action_mask_key
        epsilon = BatchedEGreedy(spec, start, end, action_mask_key=mask, **fall)
        return TensorDictSequential(greedy, epsilon), {"epsilon": lambda: epsilon.eps.squeeze(-1)}


@register
@dataclass
class BoltzmannActing(AnnealedOption):
    """Actions drawn from softmax(Q / temperature)."""

    name: str = option("boltzmann")
    temperature_init: Values = setting(0.7, per_replica(POSITIVE), "first temperature, units of Q")
    temperature_end: Values = setting(0.7, per_replica(POSITIVE), "temperature after annealing")

    requires: ClassVar[tuple[str, ...]] = ("values",)

    falls: ClassVar[tuple[str, str]] = ("temperature_init", "temperature_end")

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The policy, which writes the values, and a module that draws an action from them."""
        from tensordict.nn import TensorDictSequential

        from bbq_torchrl.exploration import Boltzmann

        start, end, fall = self.schedule(task)
        boltzmann = Boltzmann(start, end, action_mask_key=task.action_mask_key, **fall)
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


@dataclass
class IntrinsicOption(Option):
    """A reward in addition to the task's; reported rewards never include it."""

    group: ClassVar[str] = "intrinsic"

    def make(self, loss: LossModule, task: Task) -> tuple[nn.Module, list[Transform]]:
        """Returns the loss to train, and transforms of the replay buffer.

        Several losses are an ``nn.ModuleDict``, with the agent's first.

        Args:
            loss: the agent's loss.
            task: the task, for the sizes of a model.
        """
        return loss, []


@register
@dataclass
class NoIntrinsic(IntrinsicOption):
    """The task's reward alone."""

    name: str = option("none")


@register
@dataclass
class VIME(IntrinsicOption):
    """VIME: a reward for a transition's information gain about a Bayesian dynamics model."""

    name: str = option("vime")
    eta: Values = setting(0.1, per_replica(NON_NEGATIVE), "reward of the median information gain")
    weights: str = setting("map", one_of("map", "mc"), "gain at the mean weights, or at a draw")
    hidden: list[int] = setting([64, 64], COUNTS, "units of each hidden layer of the dynamics")
    prior_std: float = setting(0.1, POSITIVE, "std of the prior of the dynamics' weights")
    noise_std: float = setting(1.0, POSITIVE, "std of the standardized next state")
    std_floor: float = setting(0.05, POSITIVE, "lower bound of the std that divides a feature")
    step_size: float = setting(0.01, POSITIVE, "size of the second-order step that is measured")
    clip: float = setting(10.0, POSITIVE, "upper bound of the normalized information gain")
    median_window: int = setting(10, integers(1, 10**6), "rounds of the normalizing median")
    dynamics_every: int = setting(8, COUNT, "updates of Q for each update of the dynamics")

    def make(self, loss: LossModule, task: Task) -> tuple[nn.Module, list[Transform]]:
        """Adds the loss of the dynamics, and the transform that adds the bonus to the rewards."""
        import torch

        from bbq_torchrl.vime import DynamicsLoss, DynamicsModel, VIMEReward, vime_losses

        model = keywords(self, task, "prior_std", "noise_std", "std_floor")
        dynamics = DynamicsModel(task.inputs, task.actions, self.hidden, **task.place, **model)
        if task.inactive is not None:
            # The outputs are not reset: that a feature is constant can be learned beforehand.
            inputs, outputs = torch.cat(task.inactive), torch.zeros_like(task.inactive[0])
            with torch.no_grad():
                dynamics.network.reset_inactive_(inputs, outputs)
        names = ("eta", "weights", "step_size", "median_window", "clip")
        reward = VIMEReward(dynamics, **keywords(self, task, *names))
        return vime_losses(loss, DynamicsLoss(dynamics, every=self.dynamics_every)), [reward]
