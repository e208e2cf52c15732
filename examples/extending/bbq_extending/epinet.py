"""``agent=epinet`` and ``explore=index``: an epinet, and acting with one index per episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import AgentOption, ExploreOption, register
from bbq_torchrl.options.task import over_replicas
from bbq_torchrl.settings import COUNTS, NON_NEGATIVE, SIZE, option, setting

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

    from bbq_torchrl.options import Exploration, Task


@register
@dataclass
class Epinet(AgentOption):
    """Deep Q-network with an epinet, whose index represents epistemic uncertainty."""

    name: str = option("epinet")
    index_size: int = setting(8, SIZE, "dimensions of the index")
    epinet_hidden: list[int] = setting([50], COUNTS, "units of each hidden layer of the epinet")
    prior_hidden: list[int] = setting([16], COUNTS, "units of each hidden layer of a prior")
    prior_scale: float = setting(1.0, NON_NEGATIVE, "factor of the priors, which never learn")

    provides: ClassVar[tuple[str, ...]] = ("index",)
    explores_by: ClassVar[str] = "index"

    def make_actor(self, task: Task) -> QValueActor:
        """The base network and its epinet."""
        from bbq_extending.epinet_mlp import EpinetMLP
        from bbq_extending.index_sampling import INDEX
        from bbq_torchrl.networks import q_actor

        network = EpinetMLP(
            task.inputs,
            task.actions,
            self.hidden,
            index_size=self.index_size,
            epinet_hidden=self.epinet_hidden,
            prior_hidden=self.prior_hidden,
            prior_scale=self.prior_scale,
            replicas=task.replicas,
            device=task.device,
        )
        task.reset_inactive_(network)
        return q_actor(
            network,
            task.action_spec,
            in_keys=("observation", INDEX),
            action_mask_key=task.action_mask_key,
        )

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """The squared TD error, with an index for each row."""
        from bbq_extending.index_sampling import IndexLoss

        return IndexLoss(actor, self.index_size, gamma=over_replicas(self.gamma, task))

    def make_greedy(self, actor: QValueActor) -> TensorDictModuleBase:
        """The base network's greedy policy."""
        from bbq_extending.index_sampling import IndexSampling

        return IndexSampling(actor, self.index_size, explores=False)


@register
@dataclass
class IndexActing(ExploreOption):
    """Act greedily with one index, drawn for every dialogue."""

    name: str = option("index")

    requires: ClassVar[tuple[str, ...]] = ("index",)

    def make(self, actor: QValueActor, greedy: TensorDictModuleBase, task: Task) -> Exploration:
        """The module that draws."""
        from bbq_extending.index_sampling import IndexSampling

        return IndexSampling(actor, actor[0].module.index_size), {}
