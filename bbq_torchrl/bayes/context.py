"""Contexts whose innermost object the code inside of them finds."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

__all__ = ["Context"]


class Context:
    """A context manager; :meth:`active` is the innermost of its class that this thread is in.

    Each direct subclass has contexts of its own. An object may be entered again and again, but not
    inside of itself.

    Example:
        >>> class quiet(Context):
        ...     pass
        >>> with quiet() as outer, quiet() as inner:
        ...     quiet.active() is inner
        True
        >>> quiet.active() is None
        True
    """

    _here: threading.local

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls._here = threading.local()

    @classmethod
    def active(cls) -> Self | None:
        """Returns the innermost object, None outside of any."""
        return getattr(cls._here, "active", None)

    def __enter__(self) -> Self:
        self._outer = self.active()
        self._here.active = self
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._here.active = self._outer
