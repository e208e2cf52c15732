"""How a turn of the simulator is run: as it is, or compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from collections.abc import Callable

    from tensordict import TensorDict, TensorDictBase

    from bbq_torchrl.simulator import Simulator

__all__ = ["TurnProgram"]


class TurnProgram:
    """A turn and what is observed after it, for one simulator at a time.

    Compiled, a turn gives the same numbers, but for what a compiler may do to floating-point ones
    (the features, which are ratios of small integers).

    Args:
        compile: whether a turn is compiled by ``torch.compile``.
    """

    def __init__(self, *, compile: bool = False) -> None:
        self._is_compiled = compile
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
            self._simulator, self._shape = simulator, action.shape
            self._turn = _turn_of(simulator)
            if self._is_compiled:
                self._turn = torch.compile(self._turn, fullgraph=True, dynamic=False)
        return self._turn(state, action, draws, active)

    def __getstate__(self) -> dict[str, bool]:
        # Compiled code does not travel to another process, nor into a copy.
        return {"compile": self._is_compiled}

    def __setstate__(self, state: dict[str, bool]) -> None:
        self.__init__(**state)  # type: ignore[misc]


def _turn_of(simulator: Simulator) -> Callable[..., tuple[TensorDict, torch.Tensor]]:
    def turn(
        state: TensorDict, action: torch.Tensor, draws: TensorDictBase, active: torch.Tensor
    ) -> tuple[TensorDict, torch.Tensor]:
        after = simulator.turn(state, action, draws, active)
        return after, simulator.observe(after, active)

    return turn
