"""A griffe extension: reads the docstrings as the package writes them, in TorchRL's manner.

TorchRL heads its doctests by "Example:"; griffe's Google style knows "Examples:" only.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension

_EXAMPLE = re.compile(r"^( *)Example:$", re.MULTILINE)


class Docstrings(Extension):
    """Rewrites every docstring before it is parsed."""

    def on_instance(self, *, obj: Any, **_: Any) -> None:
        """Takes in an object that griffe has read."""
        if obj.docstring is not None:
            obj.docstring.value = _EXAMPLE.sub(r"\1Examples:", obj.docstring.value)
