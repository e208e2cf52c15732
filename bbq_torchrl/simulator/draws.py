"""The random numbers of dialogues, drawn up front."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.domains import DomainTensors

__all__ = ["uniform_draws"]


def uniform_draws(
    domain: DomainTensors,
    batch_shape: Sequence[int],
    per_slot: Sequence[str],
    per_dialogue: Sequence[str],
    generator: torch.Generator | None,
) -> TensorDict:
    """Draws uniform numbers in one call and names the parts.

    Args:
        domain: whose slots they are for, and on whose device they are.
        batch_shape: ``B``.
        per_slot: names of entries ``[*B, S]``.
        per_dialogue: names of entries ``[*B]``.
        generator: of the numbers; torch's own if there is none.

    Returns:
        A TensorDict ``[*B]`` of float32 in [0, 1).
    """
    n_slots, device = domain.n_slots, domain.records.device
    width = len(per_slot) * n_slots + len(per_dialogue)
    uniform = torch.rand(*batch_shape, width, generator=generator, device=device)
    by_slot = uniform[..., : len(per_slot) * n_slots].unflatten(-1, (len(per_slot), n_slots))
    draws = dict(zip(per_slot, by_slot.unbind(-2), strict=True))
    scalars = uniform[..., len(per_slot) * n_slots :].unbind(-1)
    return TensorDict(
        draws | dict(zip(per_dialogue, scalars, strict=True)),
        batch_size=torch.Size(batch_shape),
        device=device,
    )
