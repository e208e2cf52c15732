"""``explore=boltzmann``: actions drawn from a softmax of the values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import ExploreOption, register
from bbq_torchrl.options.settings import (
    POSITIVE,
    PROBABILITY,
    Values,
    option,
    per_replica,
    setting,
)
from bbq_torchrl.options.values import annealed_rounds, beside_dialogues, check_falls

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options import Config, Exploration, Task


@register
@dataclass
class BoltzmannActing(ExploreOption):
    """Actions drawn from softmax(Q / temperature)."""

    name: str = option("boltzmann")
    temperature_init: Values = setting(
        0.7, per_replica(POSITIVE), "temperature in the first round, units of Q"
    )
    temperature_end: Values = setting(
        0.7, per_replica(POSITIVE), "temperature from the last annealed round on"
    )
    anneal_fraction: float = setting(
        0.5, PROBABILITY, "share of the rounds over which the temperature falls, linearly"
    )

    needs: ClassVar[tuple[str, ...]] = ("values",)

    def check(self, config: Config) -> None:
        """Refuses a temperature that rises."""
        check_falls(config, "temperature_init", "temperature_end")

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The policy, which writes the values, and after it what draws an action by them."""
        from tensordict.nn import TensorDictSequential

        from bbq_torchrl.exploration import Boltzmann

        boltzmann = Boltzmann(
            beside_dialogues(self.temperature_init, task),
            beside_dialogues(self.temperature_end, task),
            annealed_rounds(self.anneal_fraction, task),
            action_mask_key=task.action_mask_key,
        )
        return (
            TensorDictSequential(greedy, boltzmann),
            {"temperature": lambda: boltzmann.temperature.squeeze(-1)},
        )
