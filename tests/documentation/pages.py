"""Parts shared by the documentation's tests: the pages and the code in them."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def snippets(page, language):
    """Returns the page's fenced code of a language, in order."""
    fence = re.compile(rf"^```{language}\n(.*?)^```", re.DOTALL | re.MULTILINE)
    return fence.findall(page.read_text(encoding="utf-8"))


def commands(program):
    """Returns the arguments of every documented command line of a program, each once."""
    found = {}
    for page in PAGES:
        for text in snippets(page, "bash"):
            for line in text.replace("\\\n", " ").splitlines():
                _, is_there, arguments = line.partition(program)
                if is_there and not line.startswith("#"):
                    found[tuple(shlex.split(arguments, comments=True))] = None
    return [list(arguments) for arguments in found]
