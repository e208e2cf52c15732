"""MkDocs hooks: files of the root as pages, TeX as MathML, Sphinx roles in docstrings as links.

``pymdownx.arithmatex`` marks the formulas; browsers show MathML without any script, so the site
needs no MathJax from elsewhere. The docstrings name other objects by Sphinx roles, as TorchRL's do.
"""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

_ROOT = Path(__file__).resolve().parents[1]
_INCLUDED = re.compile(r'^--8<-- "(?P<file>[\w.]+)"$', re.MULTILINE)
_FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<tex>.*?)\\[)\]]</(?P=tag)>', re.DOTALL
)
_ROLE = re.compile(r":(?:class|func|meth|data|attr|mod|exc|obj):<code>(?P<path>~?[\w.]+)</code>")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Returns the page with files of the root inserted and their links to docs/ adapted."""
    return _INCLUDED.sub(
        lambda match: (_ROOT / match["file"]).read_text(encoding="utf-8").replace("](docs/", "]("),
        markdown,
    )


def on_page_content(content: str, **_: Any) -> str:
    """Returns the page's HTML with formulas as MathML and roles as links."""
    return _ROLE.sub(_to_link, _FORMULA.sub(_to_mathml, content))


def _to_mathml(match: re.Match[str]) -> str:
    display = "inline" if match["tag"] == "span" else "block"
    return convert(html.unescape(match["tex"]).strip(), display=display)


def _to_link(match: re.Match[str]) -> str:
    path = match["path"].lstrip("~")
    shown = path.rpartition(".")[2] if match["path"].startswith("~") else path
    # mkdocs-autorefs fills it in; with "optional" a name without a page stays plain code.
    return f'<autoref identifier="{path}" optional><code>{shown}</code></autoref>'
