"""``explore=epsilon_greedy``: now and then a random action."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bbq_torchrl.options import ExploreOption, register
from bbq_torchrl.options.settings import PROBABILITY, Values, option, per_replica, setting
from bbq_torchrl.options.values import annealed_rounds, beside_dialogues, check_falls

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options import Config, Exploration, Task


@register
@dataclass
class EpsilonGreedy(ExploreOption):
    """With probability epsilon a uniformly random legal action, else the greedy one."""

    name: str = option("epsilon_greedy")
    eps_init: Values = setting(0.04, per_replica(PROBABILITY), "epsilon in the first round")
    eps_end: Values = setting(
        0.01, per_replica(PROBABILITY), "epsilon from the last annealed round on"
    )
    anneal_fraction: float = setting(
        0.5, PROBABILITY, "share of the rounds over which epsilon falls, linearly"
    )

    def check(self, config: Config) -> None:
        """Refuses an epsilon that rises."""
        check_falls(config, "eps_init", "eps_end")

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The policy, and after it what replaces its action."""
        from tensordict.nn import TensorDictSequential
        from torch import Tensor
        from torchrl.modules import EGreedyModule

        from bbq_torchrl.exploration import BatchedEGreedy

        start, end = (beside_dialogues(value, task) for value in (self.eps_init, self.eps_end))
        has_several = isinstance(start, Tensor) or isinstance(end, Tensor)
        epsilon = (BatchedEGreedy if has_several else EGreedyModule)(
            task.action_spec,
            eps_init=start,
            eps_end=end,
            annealing_num_steps=annealed_rounds(self.anneal_fraction, task),
            action_mask_key=task.action_mask_key,
        )
        return TensorDictSequential(greedy, epsilon), {"epsilon": lambda: epsilon.eps.squeeze(-1)}
