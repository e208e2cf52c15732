"""Checks of transitions before they are stored: bad rows are cheap to find here, and costly later.

An action outside its mask makes the loss infinite (a masked Q-value is the lowest float), and so
does a non-terminal row whose next state allows no action at all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from tensordict import TensorDictBase


def validate_transitions(rows: TensorDictBase, *, name: str = "transitions") -> None:
    """Raises if a row could not be learned from; returns nothing otherwise.

    Every floating entry must be finite. Where the rows have an ``action_mask``, which must be bool,
    the action (an index, or one-hot) must be allowed by it; where they have ``("next",
    "action_mask")``, bool too, every row that is not terminated must have some legal next action.
    One synchronization with the device for all checks together.

    Args:
        rows: transitions in TorchRL's layout, batch size [rows].
        name: what the rows are called in the error message.

    Raises:
        ValueError: names the key, the first bad row and what is allowed.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> rows = TensorDict(
        ...     {
        ...         "action": torch.tensor([0, 1]),
        ...         "action_mask": torch.tensor([[True, False], [True, False]]),
        ...     },
        ...     [2],
        ... )
        >>> validate_transitions(rows)
        Traceback (most recent call last):
        ValueError: action of transitions must be allowed by action_mask, but row 1 is not
        (1 of 2 rows)
    """
    checks: dict[str, Tensor] = {}
    for key, value in rows.items(include_nested=True, leaves_only=True):
        label = key if isinstance(key, str) else "/".join(key)
        if label in ("action_mask", "next/action_mask") and value.dtype != torch.bool:
            raise ValueError(f"{label} of {name} must be bool, got {value.dtype}")
        if value.is_floating_point():
            finite = torch.isfinite(value)
            bad = ~(finite.flatten(1).all(-1) if finite.ndim > 1 else finite)
            checks[f"{label} of {name} must be finite"] = bad
    mask = rows.get("action_mask", None)
    if mask is not None:
        checks[f"action of {name} must be allowed by action_mask"] = ~_allowed(rows["action"], mask)
    next_mask = rows.get(("next", "action_mask"), None)
    if next_mask is not None:
        terminated = rows["next", "terminated"].reshape(len(rows))
        rule = f"next/action_mask of {name} must allow some action where the row is not terminated"
        checks[rule] = ~(next_mask.any(-1) | terminated)
    if not checks:
        return
    bad = torch.stack(list(checks.values()))
    if not bool(bad.any()):
        return
    for rule, wrong in zip(checks, bad, strict=True):
        count = int(wrong.sum())
        if count:
            first = int(wrong.int().argmax())
            raise ValueError(f"{rule}, but row {first} is not ({count} of {len(rows)} rows)")


def _allowed(action: Tensor, mask: Tensor) -> Tensor:
    """Returns whether each action (index, or one-hot [rows, N]) is legal, shape [rows]."""
    if action.shape == mask.shape:
        chosen = action.bool()
        return (chosen.sum(-1) == 1) & (chosen & mask).any(-1)
    index = action.reshape(mask.shape[0], 1).long()
    inside = (index >= 0) & (index < mask.shape[-1])
    return (inside & mask.gather(-1, index.clamp(0, mask.shape[-1] - 1))).squeeze(-1)
