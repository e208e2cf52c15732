"""``explore=ucb``: optimism by the spread of the posterior's values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import ExploreOption, register
from bbq_torchrl.options.task import replica_column
from bbq_torchrl.settings import (
    NON_NEGATIVE,
    Values,
    integers,
    option,
    per_replica,
    setting,
)

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options import Exploration, Task


@register
@dataclass
class UCB(ExploreOption):
    """The action of the highest mean + coefficient · std over draws of the weights."""

    name: str = option("ucb")
    coefficient: Values = setting(
        1.0, per_replica(NON_NEGATIVE), "standard deviations added to the mean"
    )
    draws: int = setting(10, integers(2), "draws of the weights at every step")

    requires: ClassVar[tuple[str, ...]] = ("posterior",)

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws."""
        from bbq_extending.ucb_policy import UpperConfidence

        coefficient = replica_column(self.coefficient, task)
        return UpperConfidence(actor, coefficient=coefficient, draws=self.draws), {}
