"""What the exploration strategies share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, exploration_type

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey
    from torch import Tensor
    from torchrl.data import Composite
    from torchrl.modules import QValueActor

__all__ = ["ActorPolicy", "Per", "begins", "explores"]

Per = Literal["step", "episode", "round"]


def explores() -> bool:
    """Returns whether exploration modules explore: under RANDOM, and outside of any context.

    None counts as RANDOM, as it does for TorchRL's ``EGreedyModule``.
    """
    return exploration_type() in (ExplorationType.RANDOM, None)


def begins(tensordict: TensorDictBase, init_key: NestedKey) -> Tensor:
    """Returns which rows begin an episode, bool [*batch].

    Args:
        tensordict: what a policy acts on.
        init_key: the entry that says so, bool [*batch, 1] or [*batch].

    Raises:
        ValueError: if it is missing.
    """
    found = tensordict.get(init_key, None)
    if found is None:
        raise ValueError(
            f"per='episode' needs the entry {init_key!r}, True where an episode begins: append "
            "torchrl.envs.InitTracker() to the environment, or take per='step' or per='round'"
        )
    marks: Tensor = found.reshape(tensordict.batch_size)
    return marks


class ActorPolicy(TensorDictModuleBase):
    """A policy that reads and writes what its actor does.

    Args:
        actor: what chooses actions from values.
    """

    def __init__(self, actor: QValueActor) -> None:
        super().__init__()
        self.actor = actor
        self.in_keys = actor.in_keys
        self.out_keys = actor.out_keys

    @property
    def spec(self) -> Composite:
        """Specs of what the actor writes."""
        return self.actor.spec
