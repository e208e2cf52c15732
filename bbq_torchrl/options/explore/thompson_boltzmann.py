"""``explore=thompson_boltzmann``: actions drawn from a softmax of the values of a weight draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import register
from bbq_torchrl.options.explore.boltzmann import BoltzmannActing
from bbq_torchrl.options.explore.thompson import Thompson
from bbq_torchrl.options.settings import option

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options import Exploration, Task


@register
@dataclass
class ThompsonBoltzmann(BoltzmannActing, Thompson):
    """Actions drawn from softmax(Q / temperature) of a weight draw, not from its best one."""

    name: str = option("thompson_boltzmann")

    needs: ClassVar[tuple[str, ...]] = Thompson.needs

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws, and after it what draws an action by its values."""
        policy, _ = Thompson.make(self, actor, greedy, task)
        return BoltzmannActing.make(self, actor, policy, task)
