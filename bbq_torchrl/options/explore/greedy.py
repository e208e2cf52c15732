"""``explore=greedy``: no exploration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bbq_torchrl.options import ExploreOption, register
from bbq_torchrl.options.settings import option

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options import Exploration, Task


@register
@dataclass
class GreedyActing(ExploreOption):
    """The action of the highest Q-value; no exploration."""

    name: str = option("greedy")

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The agent's policy without exploration."""
        return greedy, {}
