"""Turns the TeX in the documentation into MathML, which browsers show without any script.

An MkDocs hook. ``pymdownx.arithmatex`` marks the formulas; this replaces what it marked, so that
the site needs no MathJax from elsewhere.
"""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

_FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<tex>.*?)\\[)\]]</(?P=tag)>', re.DOTALL
)


def on_page_content(content: str, **_: Any) -> str:
    """Returns the page's HTML with every formula as MathML."""
    return _FORMULA.sub(_to_mathml, content)


def _to_mathml(match: re.Match[str]) -> str:
    display = "inline" if match["tag"] == "span" else "block"
    return convert(html.unescape(match["tex"]).strip(), display=display)
