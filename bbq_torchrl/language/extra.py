"""Libraries of the extras, imported when they are needed."""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

from bbq_torchrl.extras import install_command

__all__ = ["needed"]


@cache
def needed(package: str, module: str, extra: str = "language") -> Any:
    """Returns a module of an extra's library.

    Args:
        package: what pip calls the library.
        module: what is imported.
        extra: the extra that installs it.

    Raises:
        ModuleNotFoundError: if it is not installed, with the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"{package} is needed and not installed: {install_command(extra)}",
            name=error.name,
        ) from None
