"""How a turn of the simulator is run: as it is, compiled, as a CUDA graph."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

from bbq_torchrl.modules import CudaGraph

if TYPE_CHECKING:
    from collections.abc import Callable

    from tensordict import TensorDictBase

    from bbq_torchrl.simulator import Simulator

__all__ = ["TurnProgram"]


class TurnProgram:
    """A turn and what is observed after it, for one simulator at a time.

    A turn is some hundred small operations: on a device, launching them takes longer than they
    do. Whichever way it is run, a turn gives the same numbers, but for what a compiler may do to
    floating-point ones (the features, which are ratios of small integers).

    Args:
        compile: whether a turn is compiled by ``torch.compile``.
        cuda_graph: whether a turn on a CUDA device is captured as a CUDA graph.
    """

    def __init__(self, *, compile: bool = False, cuda_graph: bool = True) -> None:
        self._is_compiled = compile
        self._is_captured = cuda_graph
        self._simulator: Simulator | None = None
        self._shape: torch.Size | None = None

    def __call__(
        self,
        simulator: Simulator,
        state: TensorDict,
        action: torch.Tensor,
        draws: TensorDictBase,
        active: torch.Tensor,
    ) -> tuple[TensorDict, torch.Tensor]:
        """Returns the next state, and the features of it.

        Args:
            simulator: whose turn it is.
            state: the state, ``[*B]``.
            action: long ``[*B]``.
            draws: what ``simulator.draw_turn`` drew, ``[*B]``.
            active: bool ``[S]``.
        """
        if simulator is not self._simulator or action.shape != self._shape:
            self._make(simulator, action.shape)
        if self._graph is None:
            return self._turn(state, action, draws, active)
        after, observation = self._graph(
            TensorDict({"state": state, "action": action, "draws": draws, "active": active})
        )
        # The next launch writes over what this one returned.
        return after.clone(), observation.clone()

    def _make(self, simulator: Simulator, shape: torch.Size) -> None:
        self._simulator, self._shape = simulator, shape
        self._turn = _turn_of(simulator)
        if self._is_compiled:
            self._turn = torch.compile(self._turn, fullgraph=True, dynamic=False)
        self._graph: CudaGraph[tuple[TensorDict, torch.Tensor]] | None = None
        if self._is_captured and CudaGraph.works_on(simulator.device):
            self._graph = CudaGraph(self._turn_of_inputs, simulator.device)

    def _turn_of_inputs(self, inputs: TensorDictBase) -> tuple[TensorDict, torch.Tensor]:
        return self._turn(inputs["state"], inputs["action"], inputs["draws"], inputs["active"])

    def __getstate__(self) -> dict[str, bool]:
        # Compiled code and graphs do not travel to another process, nor into a copy.
        return {"_is_compiled": self._is_compiled, "_is_captured": self._is_captured}

    def __setstate__(self, state: dict[str, bool]) -> None:
        self.__init__(compile=state["_is_compiled"], cuda_graph=state["_is_captured"])  # type: ignore[misc]


def _turn_of(simulator: Simulator) -> Callable[..., tuple[TensorDict, torch.Tensor]]:
    def turn(
        state: TensorDict, action: torch.Tensor, draws: TensorDictBase, active: torch.Tensor
    ) -> tuple[TensorDict, torch.Tensor]:
        after = simulator.turn(state, action, draws, active)
        return after, simulator.observe(after, active)

    return turn
