"""``explore=thompson``: act greedily on weights drawn from the posterior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import ExploreOption, register
from bbq_torchrl.options.settings import BOOLEAN, one_of, option, setting

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor

    from bbq_torchrl.options import Exploration, Task


@register
@dataclass
class Thompson(ExploreOption):
    """Draw weights from the posterior and act greedily on them."""

    name: str = option("thompson")
    per: str = setting(
        "step", one_of("step", "episode", "round"), "how long one draw of the weights is kept"
    )
    shared: bool = setting(False, BOOLEAN, "one draw for all dialogues that run side by side")

    needs: ClassVar[tuple[str, ...]] = ("posterior",)

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws."""
        from bbq_torchrl.exploration import ThompsonSampling

        return ThompsonSampling(actor, per=self.per, shared=self.shared), {}  # type: ignore[arg-type]
