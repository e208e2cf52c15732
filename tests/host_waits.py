"""What a CUDA device would be waited for, found on a CPU; and CUDA graphs played on a CPU."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from bbq_torchrl.modules import CudaGraph
from bbq_torchrl.objectives.held import Holds

if TYPE_CHECKING:
    from collections.abc import Callable

# Operations whose result's shape or whose value the host has to know.
WAITING = {
    "aten::_local_scalar_dense",
    "aten::item",
    "aten::is_nonzero",
    "aten::equal",
    "aten::nonzero",
    "aten::nonzero_numpy",
    "aten::masked_select",
    "aten::_unique",
    "aten::_unique2",
    "aten::unique_dim",
    "aten::unique_consecutive",
    "aten::bincount",
    "aten::repeat_interleave",
}
# Python's numbers as a tensor: on a CUDA device a copy that the host waits for.
FROM_THE_HOST = {"aten::lift_fresh", "aten::lift_fresh_copy"}
BY_INDEX = {"aten::index", "aten::index_put", "aten::index_put_", "aten::_index_put_impl_"}


class HostWaitError(AssertionError):
    """An operation that makes the host wait for a CUDA device."""


class NeverWaits(TorchDispatchMode):
    """Refuses, on any device, every operation that makes the host wait for a CUDA device."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func._schema.name
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, torch.Tensor)]
        if name in WAITING or name in FROM_THE_HOST:
            raise HostWaitError(f"{func} makes the host wait")
        if name in BY_INDEX and any(
            index is not None and index.dtype in (torch.bool, torch.uint8) for index in args[1]
        ):
            raise HostWaitError(f"{func} with a mask makes the host wait")
        out = func(*args, **(kwargs or {}))
        devices = {t.device for t in [*tensors, *tree_leaves(out)] if _has_place(t)}
        if len(devices) > 1:
            raise HostWaitError(f"{func} has tensors on {devices}")
        return out


def _has_place(tensor: object) -> bool:
    """Returns whether it matters where a tensor is: one number of a CPU is handed over by value."""
    return isinstance(tensor, torch.Tensor) and not (
        tensor.device.type == "cpu" and tensor.ndim == 0
    )


class Tape(TorchDispatchMode):
    """Records the operations of a block, which changes nothing, and repeats them on its tensors.

    This is what capturing and launching a CUDA graph is: the same operations on the same memory.
    Whatever a block's Python decides, it decides once.
    """

    def __init__(self) -> None:
        super().__init__()
        self._operations: list[tuple[Any, tuple, dict, object]] = []
        self._before: dict[int, tuple[torch.UntypedStorage, torch.UntypedStorage]] = {}

    def __enter__(self) -> Tape:
        self._generator_state = torch.get_rng_state()
        return super().__enter__()

    def __exit__(self, *exception: object) -> None:
        super().__exit__(*exception)
        for storage, copied in self._before.values():
            storage.copy_(copied)
        self._before.clear()
        torch.set_rng_state(self._generator_state)

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        for argument, value in _arguments(func, args, kwargs):
            if argument.alias_info is not None and argument.alias_info.is_write:
                for tensor in tree_leaves(value):
                    if isinstance(tensor, torch.Tensor):
                        storage = tensor.untyped_storage()
                        self._before.setdefault(storage._cdata, (storage, storage.clone()))
        out = func(*args, **kwargs)
        if not func._schema.returns or all(_is_new(r) for r in func._schema.returns):
            self._operations.append((func, args, kwargs, out))
        elif any(r.alias_info.is_write for r in func._schema.returns if r.alias_info):
            self._operations.append((func, args, kwargs, None))
        return out

    @torch.no_grad()
    def replay(self) -> None:
        """Repeats the operations; random ones with new numbers."""
        for func, args, kwargs, recorded in self._operations:
            out = func(*args, **kwargs)
            for old, new in zip(tree_leaves(recorded), tree_leaves(out), strict=False):
                if isinstance(old, torch.Tensor):
                    old.copy_(new)


def _is_new(returned: Any) -> bool:
    return returned.alias_info is None


def _arguments(func, args, kwargs):
    for number, argument in enumerate(func._schema.arguments):
        if number < len(args):
            yield argument, args[number]
        elif argument.name in kwargs:
            yield argument, kwargs[argument.name]


class TapeModule:
    """In the place of tensordict's CudaGraphModule, on a CPU: the same calls, the same order."""

    made: list[TapeModule]  # set by `use_tapes`

    def __init__(self, module: Callable[[], Any], warmup: int = 2, device: object = None) -> None:
        self.module = module
        self.counter = 0
        self.launches = 0
        self.made.append(self)

    def __call__(self) -> Any:
        assert not hasattr(self, "graph"), "a captured module is to be launched, not called"
        self.counter += 1
        out = self.module()
        if self.counter == 2:
            tape = Tape()
            with tape:
                self.module()
            self.graph = self
            self.tape = tape
        return out

    def replay(self) -> None:
        self.launches += 1
        self.tape.replay()


def use_tapes(monkeypatch) -> list[TapeModule]:
    """Makes :class:`~bbq_torchrl.modules.CudaGraph` record tapes here. Returns those it makes."""
    monkeypatch.setattr(TapeModule, "made", [], raising=False)
    monkeypatch.setattr("bbq_torchrl.modules.cuda_graph.CudaGraphModule", TapeModule)
    monkeypatch.setattr(CudaGraph, "works_on", staticmethod(lambda device: True))
    return TapeModule.made


def draw_as_on_a_device(monkeypatch) -> None:
    """Has noise drawn by torch's generator and nothing held or put off, as on a CUDA device."""
    monkeypatch.setattr("bbq_torchrl.modules.posterior.fill_normal_", lambda out: out.normal_())
    monkeypatch.setattr(Holds, "_holds", lambda loss, tensors: False)
    monkeypatch.setattr("bbq_torchrl.trainers.learn._AT_ONCE", 1)
