"""Makes the examples importable: each is a folder of scripts that find one another."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "examples" / "deep_sea"))
