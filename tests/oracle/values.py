"""Values are lower-case strings here; three of them are reserved."""

from __future__ import annotations

DONT_CARE = "i do not care"
NO_MATCH = "no match"
AVAILABLE = "ticket available"
RESERVED = (DONT_CARE, NO_MATCH, AVAILABLE)


def plain(value: str) -> str:
    """Returns the one spelling under which a value is compared."""
    return value.casefold()
