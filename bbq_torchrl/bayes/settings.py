"""What settings may be: numbers, one for all replicas or one for each, and words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from collections.abc import Sequence


def check_choice(name: str, value: object, choices: Sequence[str]) -> None:
    """Raises ValueError unless the value is one of the choices.

    Examples:
        >>> check_choice("mode", "drawn", ("draw", "mean"))
        Traceback (most recent call last):
        ValueError: mode must be one of ['draw', 'mean'], got 'drawn'
    """
    if value not in choices:
        raise ValueError(f"{name} must be one of {list(choices)}, got {value!r}")


def checked_number(
    name: str,
    value: float | Tensor,
    replicas: Sequence[int] = (),
    *,
    minimum: float | None = None,
    maximum: float | None = None,
) -> float | Tensor:
    """Returns a number as it is, and one for each replica as float64 [*replicas]; both checked.

    In float64, so that what is computed from them rounds as it does from one Python number.

    Args:
        name: of the setting, for the message.
        value: a number, or a tensor or list [*replicas], or a tensor [].
        replicas: the shape.

    Keyword Args:
        minimum: the least value that is allowed. Defaults to None: any above 0.
        maximum: the greatest. Defaults to None: any finite one.

    Raises:
        ValueError: for another shape, or a value that is not allowed.

    Examples:
        >>> checked_number("noise_std", 1.0), checked_number("eta", torch.tensor([1, 2]), (2,))
        (1.0, tensor([1., 2.], dtype=torch.float64))
    """
    if not isinstance(value, (int, float)):
        value = torch.as_tensor(value, dtype=torch.float64).detach()
        if value.shape not in (torch.Size(replicas), torch.Size()):
            raise ValueError(
                f"{name} must be one number or have the replicas' shape {list(replicas)}, got "
                f"{list(value.shape)}"
            )
    fits = value > 0 if minimum is None else value >= minimum
    fits &= value < math.inf if maximum is None else value <= maximum
    if not (fits.all() if isinstance(fits, Tensor) else fits):
        allowed = "positive" if minimum is None else f"at least {minimum:g}"
        allowed += " and finite" if maximum is None else f" and at most {maximum:g}"
        got = value.tolist() if isinstance(value, Tensor) else value
        raise ValueError(f"{name} must be {allowed}, got {got}")
    return value
