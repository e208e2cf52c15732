"""Replay buffers of several replicas, read in epochs of shared batches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, pad_sequence
from torch import Tensor
from torchrl.data import LazyTensorStorage, SamplerWithoutReplacement, TensorDictReplayBuffer
from torchrl.envs import Compose, Transform

from bbq_torchrl.data.rows import (
    Batch,
    ProtectedRoundRobinWriter,
    gather_rows,
    map_stored_rows,
    shuffled_indices,
    validate_transitions,
)
from bbq_torchrl.protocols import Measured, Seeded, modules_with
from bbq_torchrl.settings import at_least, check
from bbq_torchrl.utils.seeds import checked_seed

TRANSITION_KEYS: tuple[NestedKey, ...] = (
    "observation",
    "action_mask",
    "action",
    ("next", "observation"),
    ("next", "action_mask"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
)


class ReplicaReplay:
    """Replay buffers of R replicas, each with a storage, sampler and writer of TorchRL.

    R buffers are needed instead of one with R columns because replicas play dialogues of different
    lengths: their buffers fill up, wrap around and drop protected rows at different times.
    TorchRL's storages, samplers and writers have one length and one cursor, and its
    ``ReplayBufferEnsemble`` reads the same number of rows from each buffer.

    A replica's buffer contains its transitions only and is shuffled by a separate generator, so
    replicas are independent. An epoch is one permutation of each buffer
    (``SamplerWithoutReplacement``), gathered once and then split into batches of exactly
    [replicas, batch_size]. Buffers contain different numbers of rows until they are full, so the
    last batches are padded. ``valid`` marks the rows that are not padding, ``protected`` the
    protected ones, if there are any, and a replica whose epoch has ended is marked inactive.

    Args:
        capacity: the maximum number of transitions in each buffer.
        replicas: the number of replicas R. Defaults to 1.
        keys: the entries of a transition to store. Defaults to :data:`TRANSITION_KEYS`.
        transform: as in TorchRL's replay buffers. ``transform.inv`` runs on rows to be stored, and
            the entries that it adds (its ``out_keys_inv``) are stored with them; ``transform`` runs
            on the rows of an epoch. Both get batch size [replicas, rows] with the entry ``valid``.
            :mod:`bbq_torchrl.protocols` lists the optional methods of its modules.
        successes: the number of each replica's newest successful dialogues that are not evicted.
            Defaults to 0.
        device: the device of the stored transitions. Defaults to ``"cpu"``.

    Attributes:
        buffers: TorchRL's ``TensorDictReplayBuffer``, one for each replica.
        keys: the entries that :meth:`extend` reads.
        stored_keys: those entries and the ones that the transform adds.
        transform: the transform, or None.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> replay = ReplicaReplay(8, replicas=2, keys=["observation"])
        >>> replay.extend([
        ...     TensorDict({"observation": torch.ones(3, 2)}, [3]),
        ...     TensorDict({"observation": torch.zeros(1, 2)}, [1]),
        ... ])
        >>> for batch in replay.epoch(2):
        ...     print(batch.transitions["valid"].tolist(), batch.active)
        [[True, True], [True, False]] (True, True)
        [[True, False], [False, False]] (True, False)
    """

    def __init__(
        self,
        capacity: int,
        *,
        replicas: int = 1,
        keys: Sequence[NestedKey] = TRANSITION_KEYS,
        transform: Transform | None = None,
        successes: int = 0,
        device: torch.device | str = "cpu",
    ) -> None:
        check("capacity", capacity, at_least(1))
        check("replicas", replicas, at_least(1))
        self.capacity = capacity
        self.replicas = replicas
        self.keys = tuple(keys)
        self.transform = transform
        added = [key for part in _parts(transform) for key in part.out_keys_inv]
        self.stored_keys = (*self.keys, *(key for key in added if key not in self.keys))
        self._device = torch.device(device)
        self._generators = [torch.Generator(self._device) for _ in range(replicas)]
        self.buffers = tuple(
            TensorDictReplayBuffer(
                storage=LazyTensorStorage(capacity, device=self._device),
                sampler=SamplerWithoutReplacement(drop_last=False),
                writer=ProtectedRoundRobinWriter(successes),
                batch_size=1,
            )
            for _ in range(replicas)
        )
        self.seed(range(replicas))
        self._computed: dict[NestedKey, Tensor] = {}

    @property
    def lengths(self) -> tuple[int, ...]:
        """The number of transitions in each replica's buffer."""
        return tuple(len(buffer) for buffer in self.buffers)

    @property
    def protected(self) -> tuple[int, ...]:
        """The number of protected transitions of each replica, which are never evicted."""
        return tuple(buffer.writer.protected for buffer in self.buffers)

    def num_data(self) -> Tensor:
        """Returns the number of transitions that each replica learns from, int64 [replicas]."""
        return torch.tensor(self.lengths, device=self._device)

    def seed(self, seeds: Sequence[int]) -> None:
        """Reseeds the shuffling of each replica and drops pending permutations."""
        for buffer, generator, seed in zip(self.buffers, self._generators, seeds, strict=True):
            # The sampler draws the next permutation as soon as one is used up. A new sampler
            # discards it, so that an epoch depends on this seed alone, not on earlier epochs.
            buffer.set_sampler(SamplerWithoutReplacement(drop_last=False))
            buffer.set_rng(generator.manual_seed(checked_seed(seed)))
        for part in modules_with(self.transform, Seeded):
            part.set_seeds(seeds)

    def pop_metrics(self) -> dict[str, Tensor]:
        """Returns the transform's metrics since the last call, [replicas] each."""
        found: dict[str, Tensor] = {}
        for part in modules_with(self.transform, Measured):
            found |= part.pop_metrics()
        return found

    def extend(self, rows: Sequence[TensorDictBase]) -> None:
        """Stores each replica's new transitions and evicts its oldest unprotected ones if needed.

        If the rows exceed the unprotected capacity, only the last ones are stored, as they would
        overwrite the others in the same call.

        Args:
            rows: one TensorDict for each replica, batch size [rows]. An entry "succeeded", bool
                [rows], marks complete dialogues that succeed, for ``successes``.

        Raises:
            ValueError: if a row is invalid (see
                :func:`~bbq_torchrl.data.validate_transitions`). Nothing is stored then.
            KeyError: if the rows lack one of the keys.
        """
        if len(rows) != self.replicas:
            raise ValueError(f"rows must be of {self.replicas} replicas, got {len(rows)}")
        selected = [td.select(*self.keys) for td in rows]
        for replica, td in enumerate(selected):
            validate_transitions(td, name=f"replica {replica}")
        selected = [td.to(self._device) for td in selected]
        if self.transform is not None:
            for td in selected:
                td["valid"] = torch.ones(len(td), dtype=torch.bool, device=self._device)
            # Shorter ones are padded with zeros, marked invalid.
            stacked = self.transform.inv(pad_sequence(selected)).select(*self.stored_keys)
            selected = [stacked[replica, : len(td)] for replica, td in enumerate(selected)]
        self._computed.clear()
        for buffer, td, given in zip(self.buffers, selected, rows, strict=True):
            td = td[-buffer.writer.unprotected_capacity :]
            if len(td):
                index = buffer.extend(td)
                if "succeeded" in given:
                    last = given[-len(td) :]
                    buffer.writer.mark(index, last["succeeded"], last["next", "done"].squeeze(-1))

    def protect(self) -> None:
        """Protects every transition stored so far from eviction.

        Raises:
            ValueError: if they fill a replica's capacity.
        """
        for buffer in self.buffers:
            buffer.writer.check_room()
        for buffer in self.buffers:
            buffer.writer.protect()

    def compute(self, key: NestedKey, function: Callable[[TensorDictBase], Tensor]) -> None:
        """Computes an entry of every stored transition, which epochs return with the stored ones.

        It stays until it is computed again, or until transitions are stored. So values
        that are the same for every batch, such as those of a frozen network, are computed once,
        and by few large matrix products instead of many small ones.

        Args:
            key: the key of the entry; epochs return it instead of a stored entry of that key.
            function: maps transitions [replicas, rows] to values [replicas, rows, *], row by row.

        Raises:
            ValueError: if a replica has no transitions.
        """
        self._check_readable()
        self._computed[key] = map_stored_rows(self.buffers, function)

    def epoch(self, batch_size: int) -> list[Batch]:
        """Returns each replica's transitions once, shuffled separately, in shared batches.

        Args:
            batch_size: the number of rows per batch and replica.

        Raises:
            ValueError: if ``batch_size`` is not positive or a replica has no transitions.
        """
        self._check_readable(batch_size)
        indices, valid = shuffled_indices(self.buffers, batch_size)
        rows: TensorDictBase = gather_rows(
            self.buffers, self.stored_keys, indices, valid, self._computed
        )
        if any(protected := self.protected):
            # compared with numbers, as a tensor of them would make the host wait for the device
            marks = [row < first for row, first in zip(indices, protected, strict=True)]
            rows["protected"] = torch.stack(marks) & valid
        if self.transform is not None:
            rows = self.transform(rows)
        batches = rows.unflatten(1, (rows.shape[1] // batch_size, batch_size)).unbind(1)
        lengths = self.lengths
        return [
            Batch(batch, tuple(number * batch_size < length for length in lengths))
            for number, batch in enumerate(batches)
        ]

    def _check_readable(self, batch_size: int = 1) -> None:
        check("batch_size", batch_size, at_least(1))
        if min(self.lengths) == 0:
            raise ValueError(f"every replica needs a transition to learn from, got {self.lengths}")

    def state_dict(self) -> dict[str, Any]:
        """Returns the transitions, the writers' positions and the transform's state.

        The generators are not included, see :meth:`seed`.
        """
        buffers = []
        for buffer in self.buffers:
            rows: dict[str, Tensor] = {}  # by flat name, each [rows, ...]
            if len(buffer):
                stored = buffer.storage.get(slice(0, len(buffer))).select(*self.stored_keys)
                # cloned, as torch.save would write the whole storage of a view
                rows = dict(stored.flatten_keys("/").clone().items())
            buffers.append({"rows": rows, "writer": buffer.writer.state_dict()})
        transform = None if self.transform is None else dict(self.transform.state_dict())
        return {"capacity": self.capacity, "buffers": buffers, "transform": transform}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores the state from :meth:`state_dict`, with every row at the same index.

        Raises:
            ValueError: if the state has another number of replicas, capacity or transform. Nothing
                is changed then.
        """
        saved = len(state_dict["buffers"]), state_dict["capacity"]
        if saved != (self.replicas, self.capacity):
            raise ValueError(
                f"the state must be of {self.replicas} replicas and capacity {self.capacity}, got "
                f"{saved[0]} and {saved[1]}"
            )
        if (state_dict["transform"] is None) != (self.transform is None):
            raise ValueError("the state must be of a replay with the same transform")
        self._computed.clear()
        if self.transform is not None:
            self.transform.load_state_dict(state_dict["transform"])
        for buffer, state in zip(self.buffers, state_dict["buffers"], strict=True):
            buffer.empty()
            if state["rows"]:
                rows = TensorDict(dict(state["rows"])).auto_batch_size_(1)
                buffer.extend(rows.unflatten_keys("/").to(self._device))
            buffer.writer.load_state_dict(state["writer"])


def _parts(transform: Transform | None) -> list[Transform]:
    """Returns the transforms that a transform consists of."""
    if transform is None:
        return []
    return list(transform.transforms) if isinstance(transform, Compose) else [transform]
