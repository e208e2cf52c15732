"""``explore=noisy``: act greedily on a draw of the network's own noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import ExploreOption, register
from bbq_torchrl.options.settings import BOOLEAN, option, setting

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options import Exploration, Task


@register
@dataclass
class NoisyActing(ExploreOption):
    """Act greedily on one draw of the NoisyNet's noise a step."""

    name: str = option("noisy")
    shared: bool = setting(False, BOOLEAN, "one draw for all dialogues that run side by side")

    needs: ClassVar[tuple[str, ...]] = ("noise",)

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws."""
        from bbq_torchrl.exploration import NoisySampling

        return NoisySampling(actor, shared=self.shared), {}
