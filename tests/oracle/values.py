"""Values as lower-case strings, three of them reserved."""

DONT_CARE = "i do not care"
NO_MATCH = "no match"
AVAILABLE = "ticket available"
RESERVED = (DONT_CARE, NO_MATCH, AVAILABLE)


def plain(value):
    """Returns the spelling in which values are compared."""
    return value.casefold()
