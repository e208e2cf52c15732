"""The options of ``explore=``: how an agent acts while it learns."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.base import Option

if TYPE_CHECKING:
    from collections.abc import Callable

    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor
    from torchrl.modules import QValueActor

    from bbq_torchrl.options.task import Task

__all__ = ["Exploration", "ExploreOption"]

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

    @abstractmethod
    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """Makes the policy, and says what of it is worth a metric.

        Args:
            actor: the agent's Q-network with its choice of an action.
            greedy: the agent's policy without exploration.
            task: what it has to fit; the policy acts on batches [replicas, dialogues].
        """
