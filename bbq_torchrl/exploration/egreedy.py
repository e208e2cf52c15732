"""ε-greedy exploration with a separate ε for each part of a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torchrl.modules import EGreedyModule

from bbq_torchrl.exploration.base import check_batch, schedule

if TYPE_CHECKING:
    import torch
    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey
    from torch import Tensor
    from torchrl.data import TensorSpec


class BatchedEGreedy(EGreedyModule):
    """TorchRL's ``EGreedyModule`` with a separate epsilon for each part of the batch.

    TorchRL's compares its random numbers to whatever shape its buffers have, and only its
    constructor insists on one number: this one replaces the buffers.

    Args:
        spec: of the action.
        eps_init: epsilon at first, a tensor that broadcasts with the batch, such as [*replicas, 1]
            for one a replica.
        eps_end: epsilon after ``annealing_num_steps`` steps, likewise.
        annealing_num_steps: length of the schedule.

    Keyword Args:
        action_key: as in ``EGreedyModule``, like the other one.
        action_mask_key: bool [*batch, N], or None for no mask.
        device: of the schedule.

    Raises:
        ValueError: if not 1 ≥ eps_init ≥ eps_end ≥ 0, without any step, or, when called, for a
            batch that the epsilons do not broadcast with.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> epsilon = torch.tensor([[0.0], [1.0]])
        >>> explore = BatchedEGreedy(Categorical(4), epsilon, epsilon, 1)
        >>> td = TensorDict(action=torch.zeros(2, 100).long(), batch_size=[2, 100])
        >>> explore(td)["action"].float().mean(-1)
        tensor([0.0000, ...])
    """

    def __init__(
        self,
        spec: TensorSpec,
        eps_init: float | Tensor,
        eps_end: float | Tensor,
        annealing_num_steps: int = 1000,
        *,
        action_key: NestedKey = "action",
        action_mask_key: NestedKey | None = None,
        device: torch.device | None = None,
    ) -> None:
        start, end = schedule(eps_init, eps_end, annealing_num_steps)
        if not bool(((start <= 1) & (start >= end) & (end >= 0)).all()):
            raise ValueError(
                "eps_init must be at least eps_end and both be between 0 and 1, got "
                f"{start.tolist()} and {end.tolist()}"
            )
        super().__init__(
            spec,
            1.0,
            0.0,
            annealing_num_steps,
            action_key=action_key,
            action_mask_key=action_mask_key,
            device=device,
        )
        self.eps_init = start.to(device)
        self.eps_end = end.to(device)
        self.eps = start.to(device, copy=True)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action [*batch], a random one where it explores."""
        check_batch("eps", self.eps, tensordict.batch_size)
        return super().forward(tensordict)
