"""Generates conf/<group>/, and blocks in README.md and docs/, from code and results/.

A page marks a block by ``<!-- begin: name -->`` and ``<!-- end: name -->``. The text between the
marks is replaced by the result of the function of that name.

    python scripts/write_docs.py            rewrites the pages and the figures
    python scripts/write_docs.py --check    changes nothing; fails if a page is out of date
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python scripts/write_docs.py` finds its own package

from scripts.docs_blocks import BLOCKS, draw_figures  # noqa: E402
from scripts.docs_blocks.config import option_files  # noqa: E402

_NOTES = ROOT / "results" / "NOTES.md"
_BLOCK = re.compile(r"(<!-- begin: (?P<name>[\w.-]+) -->\n).*?(<!-- end: (?P=name) -->)", re.DOTALL)

Block = Callable[[], str]


def pages() -> list[Path]:
    """Returns the pages that may contain blocks."""
    return [ROOT / "README.md", _NOTES, *sorted((ROOT / "docs").rglob("*.md"))]


def rewrite(text: str, known: Mapping[str, Block], *, page: str = "the page") -> str:
    """Returns ``text`` with all blocks regenerated.

    Raises:
        ValueError: a block is unknown or not closed.
    """

    def fill(match: re.Match[str]) -> str:
        name = match["name"]
        if name not in known:
            raise ValueError(f"{page} has the unknown block {name!r}; known are {sorted(known)}")
        text = known[name]().strip()
        if page == _NOTES.name:
            text = text.replace("](figures/", "](../docs/figures/")
        return f"{match[1]}\n{text}\n\n{match[3]}"

    if len(re.findall("<!-- begin: ", text)) != len(_BLOCK.findall(text)):
        raise ValueError(f"{page} has a block that is not closed by an end of the same name")
    return _BLOCK.sub(fill, text)


def outdated(known: Mapping[str, Block]) -> dict[Path, str]:
    """Returns the outdated pages with their new text."""
    changes = {}
    for page in pages():
        old = page.read_text(encoding="utf-8")
        new = rewrite(old, known, page=page.name)
        if new != old:
            changes[page] = new
    return changes


def outdated_options() -> dict[Path, str]:
    """Returns the outdated files of ``conf/<group>/`` with their new text."""
    return {
        file: text
        for file, text in option_files().items()
        if not file.is_file() or file.read_text(encoding="utf-8") != text
    }


def main() -> int:
    """Rewrites or checks the pages; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="change nothing, fail if out of date")
    check = parser.parse_args().check
    is_outdated = False
    for find in (outdated_options, lambda: outdated(BLOCKS)):  # pages show what files compose
        for file, text in find().items():
            name, is_outdated = file.relative_to(ROOT), True
            if check:
                sys.stderr.write(f"{name} is out of date: run python scripts/write_docs.py\n")
            else:
                file.parent.mkdir(exist_ok=True)
                file.write_text(text, encoding="utf-8")
                sys.stdout.write(f"wrote {name}\n")
    if not check:
        draw_figures()
    return int(check and is_outdated)


if __name__ == "__main__":
    sys.exit(main())
