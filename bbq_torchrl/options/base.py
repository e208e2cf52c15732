"""What an option of each group is: the classes that every option extends, ours and others'.

An option is one dataclass in one file: its keys with default, bounds and meaning
(:func:`~bbq_torchrl.options.settings.setting`), what it needs or offers, and how it is made.
Importing an option does not import torch: making it does.
"""

from __future__ import annotations

import importlib.util
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.extras import install_command
from bbq_torchrl.options.settings import (
    COUNTS,
    PROBABILITY,
    REQUIRED,
    STEP_SIZE,
    ConfigError,
    Values,
    per_replica,
    setting,
)
from bbq_torchrl.options.values import spread

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor, nn
    from torchrl.envs import Transform
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule
    from torchrl.record.loggers import Logger

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options.root import Config
    from bbq_torchrl.options.task import Task
    from bbq_torchrl.trainers import ReplicaOptimizer

__all__ = [
    "AgentOption",
    "DomainOption",
    "Exploration",
    "ExploreOption",
    "IntrinsicOption",
    "LoggerOption",
    "Option",
]


@dataclass
class Option:
    """One choice of a group of the configuration.

    A class is made an option by :func:`~bbq_torchrl.options.register`; its field ``name`` says
    which (:func:`~bbq_torchrl.options.settings.option`).

    Attributes:
        group: the group that it belongs to; set by the base class of the group.
    """

    name: str = REQUIRED

    group: ClassVar[str]

    def check(self, config: Config) -> None:
        """Refuses what cannot be combined; each value alone has been checked by then.

        Raises:
            ConfigError: one sentence that names the key, its value and what is allowed.
        """


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

    def make_actor(self, task: Task) -> QValueActor:
        """Makes the Q-network and its choice of an action.

        Weights are drawn from torch's global generator, and have the replicas as their first
        dimension. Of what is not active yet they start by :meth:`Task.reset_inactive_`.
        """
        raise NotImplementedError

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """Makes what is learned: a loss with ``loss`` (scalar) and ``loss_value`` [replicas]."""
        raise NotImplementedError

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


Exploration = tuple["TensorDictModuleBase", "dict[str, Callable[[], float | Tensor]]"]
"""A policy, and what of it is worth a column of the metrics: one number, or [replicas]."""


@dataclass
class ExploreOption(Option):
    """How an agent acts while it learns.

    Attributes:
        needs: what an agent must offer (:attr:`AgentOption.offers`) to explore so.
    """

    group: ClassVar[str] = "explore"

    needs: ClassVar[tuple[str, ...]] = ()

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """Makes the policy, and says what of it is worth a metric.

        Args:
            actor: the agent's Q-network with its choice of an action.
            greedy: the agent's policy without exploration.
            task: what it has to fit; the policy acts on batches [replicas, dialogues].
        """
        raise NotImplementedError


@dataclass
class IntrinsicOption(Option):
    """What the agent is rewarded for besides the task; never part of a reported reward."""

    group: ClassVar[str] = "intrinsic"

    def make(self, loss: LossModule, task: Task) -> tuple[LossModule, list[Transform]]:
        """Returns the loss that is learned, and what the replay buffer has to do for it.

        Args:
            loss: the agent's.
            task: what a model of the task has to fit.
        """
        return loss, []


@dataclass
class DomainOption(Option):
    """What the dialogues are about."""

    group: ClassVar[str] = "domain"

    def resolve_path(self) -> None:
        """Makes the key ``path`` absolute, where there is one: a run may go on elsewhere."""
        if path := getattr(self, "path", ""):
            self.path = os.path.abspath(os.path.expanduser(path))

    def make(self) -> Domain:
        """Loads the domain.

        Raises:
            ValueError or OSError: the corpus is damaged or not there.
        """
        raise NotImplementedError


@dataclass
class LoggerOption(Option):
    """Where metrics go besides metrics.csv, which is always written."""

    group: ClassVar[str] = "logger"

    package: ClassVar[str] = ""
    """What has to be installed, and the extra that brings it; empty: nothing."""

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes TorchRL's loggers of a run.

        Args:
            run_folder: where they write.
            resume: whether the run goes on from an earlier process.
        """
        raise NotImplementedError

    def check_package(self) -> None:
        """Raises ConfigError, which names the extra to install, where the package is missing."""
        if self.package and importlib.util.find_spec(self.package) is None:
            raise ConfigError(
                f"logger={self.name} needs the package {self.package}: "
                f"{install_command(self.package)}"
            )
