"""A function of tensors as a CUDA graph: one launch a call, and nobody waits for the device."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Generic, TypeVar

import torch
from tensordict.nn import CudaGraphModule

if TYPE_CHECKING:
    from collections.abc import Callable

    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey

__all__ = ["CudaGraph"]

Outputs = TypeVar("Outputs")


class CudaGraph(Generic[Outputs]):
    """Calls a function of a TensorDict, on a CUDA device as a CUDA graph.

    A small network's update is some hundred kernels of a few microseconds, which a host cannot
    launch as fast as the device is done with them. Captured, they are launched at once.

    TensorDict's :class:`~tensordict.nn.CudaGraphModule` runs the function at the first call and
    captures it at the second. Its own later calls wait for the device before they launch the
    graph (tensordict 0.14); here the inputs are copied into those of the graph, in the order of
    the stream, and the graph is launched without waiting. On other devices each call is a call
    of the function.

    What is captured is what the device does. So the function must

    - have inputs of fixed shapes, and do the same whatever the numbers in them are;
    - wait for nothing: no ``item()``, no mask as an index, no tensor made from a list;
    - find everything else that it reads or changes (parameters, buffers, an optimiser's moments)
      in the same memory at each call: others have to change it in place;
    - expect nothing of its work on the host, which is done at the first two calls only (twice
      at the second), nor of autograd: gradients are computed and used inside, or not at all.

    Random numbers of torch's default generator are new at each call, as without a graph.

    Args:
        function: from a TensorDict to a TensorDict, or to None. What it returns is overwritten
            by the next call: clone what is to stay.
        device: where the tensors are.

    Raises:
        ValueError: when called with inputs of other shapes than at first, on a CUDA device.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from bbq_torchrl.modules import CudaGraph
        >>> total = torch.zeros(2)
        >>> def add(inputs):
        ...     total.add_(inputs["x"])
        >>> graph = CudaGraph(add, torch.device("cpu"))
        >>> for _ in range(3):
        ...     graph(TensorDict(x=torch.ones(2)))
        >>> total
        tensor([3., 3.])
    """

    def __init__(self, function: Callable[[TensorDictBase], Outputs], device: torch.device) -> None:
        self._function = function
        self._device = device
        self._module: CudaGraphModule | None = None
        self._inputs: TensorDictBase
        self._keys: list[NestedKey]
        self._outputs: Outputs

    @staticmethod
    def works_on(device: torch.device) -> bool:
        """Whether work on a device can be captured; that of another would leave a graph empty."""
        return device.type == "cuda"

    @property
    def is_captured(self) -> bool:
        """Whether calls launch a graph by now."""
        return hasattr(self._module, "graph")

    def __call__(self, inputs: TensorDictBase) -> Outputs:
        """Returns what the function returns.

        Args:
            inputs: with the entries that it had at first; further ones are not read.
        """
        if not self.works_on(self._device):
            return self._function(inputs)
        module = self._module
        if module is None:
            module = self._module = self._begin(inputs)
        else:
            self._take_in(inputs)
        if self.is_captured:
            module.graph.replay()
            return self._outputs
        # The capture runs the function a second time, without a result: what the first run
        # returned is handed on.
        return module()

    def _begin(self, inputs: TensorDictBase) -> CudaGraphModule:
        self._inputs = inputs.clone()
        # Fixed now: the function may add entries.
        self._keys = list(self._inputs.keys(True, True))
        with warnings.catch_warnings():
            # It unregisters TensorDict from torch's pytrees, which nothing here needs.
            warnings.filterwarnings("ignore", message="Tensordict is registered in PyTree")
            return CudaGraphModule(self._run, device=self._device)

    def _take_in(self, inputs: TensorDictBase) -> None:
        ours = [self._inputs.get(key) for key in self._keys]
        theirs = [inputs.get(key) for key in self._keys]
        for key, own, given in zip(self._keys, ours, theirs, strict=True):
            if own.shape != given.shape:
                raise ValueError(
                    f"{key!r} must have the shape {list(own.shape)} that was captured, got "
                    f"{list(given.shape)}"
                )
        torch._foreach_copy_(ours, theirs)

    def _run(self) -> Outputs:
        self._outputs = self._function(self._inputs)
        return self._outputs
