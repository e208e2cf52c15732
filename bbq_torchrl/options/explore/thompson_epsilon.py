"""``explore=thompson_epsilon``: Thompson sampling, and now and then a random action."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import register
from bbq_torchrl.options.explore.epsilon_greedy import EpsilonGreedy
from bbq_torchrl.options.explore.thompson import Thompson
from bbq_torchrl.options.settings import option

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options import Exploration, Task


@register
@dataclass
class ThompsonEpsilon(EpsilonGreedy, Thompson):
    """Thompson sampling, and with probability epsilon a uniformly random legal action."""

    name: str = option("thompson_epsilon")

    needs: ClassVar[tuple[str, ...]] = Thompson.needs

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws, and after it what replaces its action."""
        policy, _ = Thompson.make(self, actor, greedy, task)
        return EpsilonGreedy.make(self, actor, policy, task)
