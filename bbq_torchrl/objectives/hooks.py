"""What a loss may have besides ``forward``, and what the trainer does where it has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor


class UsesNumData(Protocol):
    """A loss that weighs a prior against the number of data. Others are not told it."""

    def set_num_data(self, num_data: Tensor) -> None:
        """Takes the number of stored transitions, int64 [replicas]; called before learning."""


class BeginsEpochs(Protocol):
    """A loss that does something once an epoch. Others do everything at every update."""

    def begin_epoch(self) -> None:
        """Called before each epoch over the buffers."""


class FixedTargets(Protocol):
    """A loss whose targets may be computed once a freeze, for the whole buffer.

    Others compute their targets at every update, and so does one whose ``has_fixed_targets`` is
    False.

    Attributes:
        has_fixed_targets: whether the targets are the same for every batch until the next freeze.
        tensor_keys: names, as ``next_state_value``, the entry of "next" that the values go to.
    """

    @property
    def has_fixed_targets(self) -> bool:
        """Whether the targets are the same for every batch until the next freeze."""

    @property
    def tensor_keys(self) -> Any:
        """Its keys."""

    def next_state_values(self, tensordict: TensorDictBase, /) -> Tensor:
        """Returns the frozen network's values of transitions [replicas, rows], the same shape."""
