"""Markdown of the pages."""

from __future__ import annotations

from bbq_torchrl.evaluation.markdown import table

__all__ = ["code", "table"]


def code(text: object) -> str:
    """Returns ``text`` as inline code."""
    return f"`{text}`"
