"""A round-robin writer that never overwrites a storage's first rows and newest successes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data import TensorDictRoundRobinWriter

_OWN = "protected.json"  # in the folder of TorchRL's writer


class ProtectedRoundRobinWriter(TensorDictRoundRobinWriter):
    """A first-in, first-out writer that keeps the first rows of the storage.

    Until :meth:`protect` is called, it behaves like TorchRL's
    :class:`~torchrl.data.TensorDictRoundRobinWriter`. Afterwards the rows in the storage at that
    moment are never overwritten, and new rows take turns in the remaining capacity. So a replay
    buffer *spiked* with the dialogues of a rule policy keeps them during all of training.

    Likewise the rows of the newest ``successes`` successful dialogues are skipped, as long as there
    are others to overwrite.

    Args:
        successes: the number of successful dialogues to keep. Defaults to 0.

    Attributes:
        protected: the number of rows, from the first, that are never overwritten.

    Raises:
        ValueError: if more rows are written at once than the unprotected capacity.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> buffer = TensorDictReplayBuffer(
        ...     storage=LazyTensorStorage(4), writer=ProtectedRoundRobinWriter(), batch_size=1
        ... )
        >>> _ = buffer.extend(TensorDict({"x": torch.tensor([1, 2])}, [2]))
        >>> buffer.writer.protect()
        >>> for x in (3, 4, 5):
        ...     _ = buffer.extend(TensorDict({"x": torch.tensor([x])}, [1]))
        >>> buffer[:]["x"]
        tensor([1, 2, 5, 4])
    """

    def __init__(self, successes: int = 0) -> None:
        super().__init__()
        self.successes = successes
        self.protected = 0
        # of each row of the storage, the number of its dialogue among the successful ones, or 0
        self._success = torch.zeros(0, dtype=torch.int64)

    @property
    def unprotected_capacity(self) -> int:
        """The number of rows of the storage that are written in turns."""
        return int(self._storage.max_size) - self.protected

    def check_room(self) -> None:
        """Raises ValueError if the storage is full: protecting all rows would leave no room."""
        rows = len(self._storage)
        if rows >= self._storage.max_size:
            raise ValueError(
                f"protected rows must be fewer than the capacity {self._storage.max_size} of the "
                f"storage, got {rows}"
            )

    def protect(self) -> None:
        """Protects every row that is in the storage now.

        Raises:
            ValueError: as :meth:`check_room` does.
        """
        self.check_room()
        self.protected = self._cursor = len(self._storage)

    def add(self, data: TensorDictBase) -> torch.Tensor:
        """Writes one row and returns its index, shape []."""
        return self.extend(data.unsqueeze(0))[0]

    def extend(self, data: TensorDictBase) -> torch.Tensor:
        """Writes rows in turns and returns their indices, shape [rows]."""
        rows, room = len(data), self.unprotected_capacity
        if rows == 0:
            raise ValueError("extend needs at least one row, got 0")
        if rows > room:
            raise ValueError(
                f"extend writes at most {room} rows at once (capacity {self._storage.max_size}, "
                f"{self.protected} protected), got {rows}"
            )
        device = data.device if data.device is not None else "cpu"
        start = self._cursor - self.protected
        if self._success.any():
            turns = torch.arange(start, start + room) % room + self.protected
            number = self._success[turns]
            kept = number > max(0, int(self._success.max()) - self.successes)
            index = turns[kept.int().argsort(stable=True)[:rows]]
            self._success[index] = 0
            start = int(index[-1]) + 1 - self.protected - rows
            index = index.to(device)
        else:
            index = torch.arange(start, start + rows, device=device) % room + self.protected
        self._cursor = self.protected + (start + rows) % room
        self._write_count += rows
        data.set("index", index)
        self._storage.set(index, data)
        self._bump_generation(index, data)
        self._mark_update_entities(index)
        return index

    def mark(self, index: torch.Tensor, succeeded: torch.Tensor, done: torch.Tensor) -> None:
        """Marks rows of successful dialogues, which :meth:`extend` has just written.

        Args:
            index: their places in the storage, int64 [rows].
            succeeded: whether a row's dialogue succeeds, bool [rows].
            done: whether it ends with the row, bool [rows].
        """
        if self.successes and (succeeded := succeeded.cpu()).any():
            if not len(self._success):
                self._success = torch.zeros(self._storage.max_size, dtype=torch.int64)
            ends = (succeeded & done.cpu()).long()
            number = self._success.max() + 1 + ends.cumsum(0) - ends
            self._success[index.cpu()] = torch.where(succeeded, number, 0)

    def _empty(self, empty_write_count: bool = True) -> None:
        super()._empty(empty_write_count=empty_write_count)
        self.protected = 0
        self._success = self._success[:0]

    def state_dict(self) -> dict[str, Any]:
        """Returns the cursor, the numbers of written and protected rows, and the successes."""
        kept = {"_success": self._success} if self.successes else {}
        return {**super().state_dict(), "_protected": self.protected, **kept}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores the state from :meth:`state_dict`."""
        super().load_state_dict(state_dict)
        self.protected = state_dict["_protected"]
        self._success = state_dict.get("_success", self._success[:0]).clone()

    def dumps(self, path: Path | str) -> None:
        """Writes the state from :meth:`state_dict` into a folder."""
        super().dumps(path)
        own = {"protected": self.protected, "success": self._success.tolist()}
        (Path(path) / _OWN).write_text(json.dumps(own), encoding="utf-8")

    def loads(self, path: Path | str) -> None:
        """Restores the state written by :meth:`dumps`."""
        super().loads(path)
        own = json.loads((Path(path) / _OWN).read_text(encoding="utf-8"))
        self.protected = own["protected"]
        self._success = torch.tensor(own["success"], dtype=torch.int64)
