"""Command lines: ``bbq``, ``bbq evaluate``, ``bbq bench`` and ``bbq domains``."""
