"""Turns as code that ``torch.compile`` makes of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from tensordict import TensorDict

    from bbq_torchrl.simulator import Simulator


class CompiledPlay:
    """A simulator's turn, compiled; a copy and another process compile it anew.

    It gives the same numbers, but for what a compiler may do to floating-point ones (the features,
    which are ratios of small integers).
    """

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        # Else all environments of a process together have the 8 programs that torch allows a turn.
        # (Torch's overloads lack the keyword.)
        self._play = torch.compile(  # type: ignore[call-overload]
            simulator.play, fullgraph=True, dynamic=False, isolate_recompiles=True
        )

    def __call__(self, *state_and_action: Any) -> tuple[TensorDict, torch.Tensor]:
        """Plays one turn, as :meth:`~bbq_torchrl.simulator.Simulator.play`."""
        return self._play(*state_and_action)

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledPlay, (self._simulator,)
