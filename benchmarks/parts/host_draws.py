"""Random numbers drawn on the CPU for any device, so that two devices can be compared."""

from __future__ import annotations

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

_CPU = torch.device("cpu")


class DrawsOnTheHost(TorchDispatchMode):
    """Draws every random number on the CPU and copies it to its device.

    A generator of another device is replaced by one of the CPU with the same seed, which starts
    again whenever the former is seeded anew. Without a generator it is torch's global one of the
    CPU. So a program draws the same numbers on every device.
    """

    def __init__(self) -> None:
        super().__init__()
        self._twins: dict[torch.Generator, tuple[int, torch.Generator]] = {}

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        if torch.Tag.nondeterministic_seeded not in func.tags:
            return func(*args, **kwargs)
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, torch.Tensor)]
        places = {tensor.device for tensor in tensors} | {kwargs.get("device") or _CPU}
        device = next((place for place in places if torch.device(place).type != "cpu"), None)
        if device is None:
            return func(*args, **kwargs)
        out = func(*tree_map(self._on_the_host, args), **tree_map(self._on_the_host, kwargs))
        if func._schema.name.endswith("_"):  # in place
            return args[0].copy_(out)
        return tree_map(lambda leaf: leaf.to(device) if torch.is_tensor(leaf) else leaf, out)

    def _on_the_host(self, leaf: object) -> object:
        if isinstance(leaf, torch.Tensor):
            return leaf.to(_CPU)
        if isinstance(leaf, torch.Generator):
            return leaf if leaf.device == _CPU else self._twin(leaf)
        return _CPU if isinstance(leaf, torch.device) else leaf

    def _twin(self, generator: torch.Generator) -> torch.Generator:
        seed = generator.initial_seed()
        if generator not in self._twins or self._twins[generator][0] != seed:
            self._twins[generator] = seed, torch.Generator().manual_seed(seed)
        return self._twins[generator][1]
