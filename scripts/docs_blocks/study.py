"""The block that shows the report of the paper's study with simulated users."""

from __future__ import annotations

import re
import shutil
from typing import TYPE_CHECKING

from scripts.docs_blocks.common import FIGURES, RESULTS, block

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["copy_figures"]

REPORT = RESULTS / "study"


def copy_figures() -> list[Path]:
    """Copies the report's figures to the documentation's; returns the files."""
    made = []
    for name in ("success", "ratings"):
        made.append(FIGURES / f"study_simulated_{name}.png")
        shutil.copyfile(REPORT / f"{name}.png", made[-1])
    return made


@block("study.simulated")
def _simulated() -> str:
    """Returns the report as it is, a level deeper."""
    text = (REPORT / "report.md").read_text(encoding="utf-8")
    text = re.sub(r"\]\((\w+)\.png\)", r"](figures/study_simulated_\1.png)", text)
    return re.sub("^#", "###", text, count=1).replace("\n## ", "\n#### ")
