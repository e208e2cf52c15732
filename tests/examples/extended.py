"""The folder of the examples, and a training that takes no time."""

from pathlib import Path

from tiny import TINY

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
PACKAGE = EXAMPLES / "extending"

OF_DIALOGUES = ("spike.", "env.", "domain=")
SHRUNKEN = tuple(key for key in TINY if not key.startswith(OF_DIALOGUES))
SHRUNKEN += ("env=chain", "env.length=5", "spike=none", "replicas=2")
