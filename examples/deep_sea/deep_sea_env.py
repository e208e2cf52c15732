"""DeepSea, the benchmark of deep exploration (Osband et al. 2017), as a TorchRL environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
import torch.nn.functional as F
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictBase

MOVE_COST = 0.01
"""The cost of N steps to the right, in units of the treasure."""


class DeepSeaEnv(EnvBase):
    """A diver in an N x N grid, which sinks one row in each of N steps, to the left or right.

    A step to the right costs .01 / N, a step to the left nothing. A treasure of 1 is in the bottom
    right corner, left to the right, which only N steps to the right reach. The action that means
    right is drawn for every cell, so learning does not generalize between cells. Random actions
    find the treasure in one of 2^N episodes, and all rewards on the way discourage going there.

    ===============  ===========  ==========================================================
    key              shape        meaning
    ===============  ===========  ==========================================================
    ``observation``  ``*B, N·N``  float32, 1 in the diver's cell (row by row); 0 at the end
    ``action``       ``*B``       int64, 0 or 1
    ``reward``       ``*B, 1``    float32
    ``done``         ``*B, 1``    bool; always ``terminated``, never ``truncated``
    ``treasure``     ``*B, 1``    bool, the episode has ended with the treasure
    ===============  ===========  ==========================================================

    A diver at the bottom stays there, without reward, until it is reset.

    Args:
        size: N, rows and columns of the grid.
        batch_size: the shape of the batch of divers.

    Keyword Args:
        mapping_seed: what draws the meaning of the actions: one seed for all divers, or one for
            each element of the first batch dimension. Defaults to 0.
        device: where the divers are.

    Raises:
        ValueError: if the size is not positive, or the seeds do not fit the batch.

    Examples:
        >>> env = DeepSeaEnv(10, batch_size=(5, 1), mapping_seed=range(5))
        >>> env.rollout(10)["next", "reward"].shape
        torch.Size([5, 1, 10, 1])
        >>> best = env.right_action.diagonal(dim1=-2, dim2=-1)  # the way to the treasure
        >>> way = iter(best.unbind(-1))
        >>> rollout = env.rollout(10, lambda td: td.set("action", next(way)))
        >>> rollout["next", "reward"].sum(-2).flatten()
        tensor([0.9900, 0.9900, 0.9900, 0.9900, 0.9900])
    """

    def __init__(
        self,
        size: int,
        batch_size: Sequence[int] = (),
        *,
        mapping_seed: int | Sequence[int] = 0,
        device: torch.device | str = "cpu",
    ) -> None:
        if size < 1:
            raise ValueError(f"size must be at least 1, got {size}")
        super().__init__(device=device, batch_size=torch.Size(batch_size))
        self.size = size
        self._right = _draw_mapping(size, self.batch_size, mapping_seed).to(self.device)
        self._row = torch.zeros(self.batch_size, dtype=torch.int64, device=self.device)
        self._column = torch.zeros_like(self._row)
        self._treasure = torch.zeros_like(self._row, dtype=torch.bool)
        self._make_specs()

    @property
    def right_action(self) -> torch.Tensor:
        """The action that means right, in every row and column: int64, shape [*batch, N, N]."""
        return self._right.unflatten(-1, (self.size, self.size))

    def _make_specs(self) -> None:
        batch, device = self.batch_size, self.device
        cells, one = self.size**2, (*self.batch_size, 1)
        self.observation_spec = Composite(
            observation=Bounded(0, 1, (*batch, cells), device=device, dtype=torch.float32),
            treasure=Binary(1, one, device=device, dtype=torch.bool),
            shape=batch,
        )
        self.action_spec = Categorical(2, batch, device=device, dtype=torch.int64)
        self.reward_spec = Unbounded(one, device=device, dtype=torch.float32)
        flag = Binary(1, one, device=device, dtype=torch.bool)
        self.done_spec = Composite(
            done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=batch
        )

    def _set_seed(self, seed: int | None) -> None:
        """Does nothing: only the mapping of actions is random."""

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        which = None if tensordict is None else tensordict.get("_reset", None)
        stays = torch.zeros_like(self._treasure) if which is None else ~which.squeeze(-1)
        self._row, self._column = self._row * stays, self._column * stays
        self._treasure = self._treasure & stays
        return self._emit()

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        size = self.size
        under_way = self._row < size
        cell = self._row.clamp_max(size - 1) * size + self._column
        goes_right = tensordict["action"] == self._right.gather(-1, cell[..., None])[..., 0]
        goes_right &= under_way
        # The last column is only reached in the last row.
        found = goes_right & (self._column == size - 1)
        reward = found.float() - goes_right.float() * (MOVE_COST / size)
        moved = (self._column + 2 * goes_right.long() - 1).clamp(0, size - 1)
        self._column = torch.where(under_way, moved, self._column)
        self._row = self._row + under_way.long()
        self._treasure = self._treasure | found
        return self._emit().set("reward", reward[..., None])

    def _emit(self) -> TensorDict:
        """Returns the observations of the divers."""
        cells = self.size**2
        done = (self._row == self.size)[..., None]
        # At the bottom row·N is N·N: the cell past the grid, which is cut off.
        place = (self._row * self.size + self._column).clamp_max(cells)
        observation = F.one_hot(place, cells + 1)[..., :cells].float()
        return TensorDict(
            {
                "observation": observation,
                "treasure": self._treasure[..., None].clone(),
                "done": done,
                "terminated": done.clone(),
                "truncated": torch.zeros_like(done),
            },
            batch_size=self.batch_size,
            device=self.device,
        )


def _draw_mapping(size: int, batch: torch.Size, mapping_seed: int | Sequence[int]) -> torch.Tensor:
    """Returns the action that means right in each cell, int64 [*batch, N·N]."""
    if isinstance(mapping_seed, int):
        return _mapping(size, mapping_seed).expand(*batch, -1)
    seeds = list(mapping_seed)
    if not batch or len(seeds) != batch[0]:
        raise ValueError(
            "mapping_seed must be one number or one for each element of the first batch "
            f"dimension, got {len(seeds)} seeds for the batch size {list(batch)}"
        )
    drawn = torch.stack([_mapping(size, seed) for seed in seeds])
    return drawn.view(batch[0], *(1 for _ in batch[1:]), size**2).expand(*batch, -1)


def _mapping(size: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(2, (size**2,), generator=generator)
