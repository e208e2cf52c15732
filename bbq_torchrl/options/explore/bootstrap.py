"""``explore=bootstrap``: act greedily on one head."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import ExploreOption, register
from bbq_torchrl.options.settings import one_of, option, setting

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options import Exploration, Task


@register
@dataclass
class BootstrapActing(ExploreOption):
    """Act greedily on one of the heads, drawn for every dialogue."""

    name: str = option("bootstrap")
    per: str = setting(
        "episode", one_of("step", "episode", "round"), "how long one draw of a head is kept"
    )

    needs: ClassVar[tuple[str, ...]] = ("heads",)

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws."""
        from bbq_torchrl.exploration import BootstrapSampling

        return BootstrapSampling(actor, per=self.per), {}  # type: ignore[arg-type]
