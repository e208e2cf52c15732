"""The options of ``agent=``: what learns."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.base import Option
from bbq_torchrl.options.settings import (
    COUNTS,
    PROBABILITY,
    STEP_SIZE,
    ConfigError,
    Values,
    per_replica,
    setting,
)
from bbq_torchrl.options.values import spread

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tensordict.nn import TensorDictModuleBase
    from torch import nn
    from torchrl.envs import Transform
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

    from bbq_torchrl.options.task import Task
    from bbq_torchrl.trainers import ReplicaOptimizer

__all__ = ["AgentOption"]


@dataclass
class AgentOption(Option):
    """What learns: a Q-network of some hidden layers, trained by Adam.

    Attributes:
        offers: what exploration can use of it: any of ``posterior``, ``heads``, ``noise``,
            ``values`` (one Q-value an action), or a word that a strategy of your own needs.
        explores_by: the strategy that it has where none is chosen.
        modes: of :meth:`make_evaluation`, where there are several policies to evaluate.
    """

    group: ClassVar[str] = "agent"

    hidden: list[int] = setting([256, 256], COUNTS, "units of each hidden layer")
    lr: Values = setting("${protocol.lr}", per_replica(STEP_SIZE), "step size of Adam")
    gamma: Values = setting(0.9, per_replica(PROBABILITY), "discount of a turn")

    offers: ClassVar[tuple[str, ...]] = ("values",)
    explores_by: ClassVar[str] = "epsilon_greedy"
    modes: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def make_actor(self, task: Task) -> QValueActor:
        """Makes the Q-network and its choice of an action.

        Weights are drawn from torch's global generator, and have the replicas as their first
        dimension: a network of your own says so by an attribute ``replicas``, the number of them.
        Of what is not active yet they start by :meth:`Task.reset_inactive_`.
        """

    @abstractmethod
    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """Makes what is learned: a loss with ``loss`` (scalar) and ``loss_value`` [replicas]."""

    def make_optimizer(
        self, actor: QValueActor, parameters: Iterable[nn.Parameter], task: Task
    ) -> ReplicaOptimizer:
        """Makes what moves the parameters: Adam, for each replica its own.

        Args:
            actor: of :meth:`make_actor`.
            parameters: all that are learned: the actor's, and those of an intrinsic reward's model.
            task: what they fit.
        """
        from bbq_torchrl.trainers import ReplicaAdam

        rates = list(map(float, spread(self.lr, task.replicas)))
        return ReplicaAdam(parameters, task.replicas, lr=rates)

    def make_greedy(self, actor: QValueActor) -> TensorDictModuleBase:
        """Makes the policy that acts without exploration."""
        from bbq_torchrl.exploration import Greedy

        return Greedy(actor)

    def make_evaluation(
        self, actor: QValueActor, mode: str | None = None
    ) -> tuple[str, TensorDictModuleBase]:
        """Returns the name of the policy that is to be reported, and that policy.

        Args:
            actor: of :meth:`make_actor`.
            mode: one of :attr:`modes`; None: the agent's own.
        """
        return "greedy", self.make_greedy(actor)

    def check_mode(self, mode: str | None) -> None:
        """Refuses a mode that is not one of the agent's."""
        if mode is not None and mode not in self.modes:
            several = f"one of {', '.join(self.modes)} or " if self.modes else ""
            raise ConfigError(f"mode must be {several}null for agent={self.name}, got {mode!r}")

    def make_transforms(self, task: Task) -> list[Transform]:
        """Returns what the replay buffer has to do for the agent."""
        return []
