"""Which hooks an object has: a protocol names them, beside the room of what has them.

The loss's are in :mod:`bbq_torchrl.objectives.hooks`, those of a policy's modules in
:mod:`bbq_torchrl.exploration.hooks`, those of a replay's transform in
:mod:`bbq_torchrl.data.hooks`; a network's is :class:`bbq_torchrl.networks.growth.Growing` and the
environment's :class:`bbq_torchrl.trainers.RoundEnv`. An object need not inherit from a protocol;
each says what happens where an object does not follow it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeGuard, TypeVar, cast

if TYPE_CHECKING:
    from torch import nn

Hooks = TypeVar("Hooks")


def provides(owner: object, hooks: type[Hooks]) -> TypeGuard[Hooks]:
    """Returns whether an object has all that a protocol names.

    Unlike ``isinstance`` with a runtime-checkable protocol (from Python 3.12 on) it finds what a
    wrapper hands on from what it wraps, such as TorchRL's ``TransformedEnv``.

    Args:
        owner: the object.
        hooks: the protocol.

    Examples:
        >>> from bbq_torchrl.exploration.hooks import Resampled
        >>> class Policy:
        ...     def resample(self) -> None: ...
        >>> provides(Policy(), Resampled), provides(object(), Resampled)
        (True, False)
    """
    named = {name: item for name, item in vars(hooks).items() if not name.startswith("_")}
    return all(
        callable(getattr(owner, name, None)) if callable(item) else hasattr(owner, name)
        for name, item in named.items()
    )


def modules_with(root: nn.Module | None, hooks: type[Hooks]) -> list[Hooks]:
    """Returns the modules within one that have all that a protocol names; none of None.

    What a wrapper such as ``TensorDictModule`` hands on is not its own: what it wraps is among the
    modules, and is not to be called twice.

    Args:
        root: the module.
        hooks: the protocol.
    """
    modules = () if root is None else root.modules()
    return [cast("Hooks", module) for module in modules if provides(type(module), hooks)]
