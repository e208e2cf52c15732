"""A griffe extension that shows ``**settings: Unpack[LayerSettings]`` as keywords with types."""

from __future__ import annotations

from typing import Any

from griffe import Function, UnpackTypedDictExtension


class Keywords(UnpackTypedDictExtension):
    """griffe's extension, without the section that it adds to constructors without a docstring.

    The docstring of the class has the meanings.
    """

    def on_function(self, *, func: Function, **kwargs: Any) -> None:
        """Adds the keywords to a signature."""
        super().on_function(func=func, **kwargs)
        if func.docstring is not None and not func.docstring.value:
            func.docstring = None
