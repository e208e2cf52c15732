"""Command lines: ``bbq``, ``bbq evaluate`` and ``bbq domains``."""
