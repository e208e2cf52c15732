"""The folder of the examples, and a training that takes no time."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
PACKAGE = EXAMPLES / "extending"

SHRUNKEN = (
    "protocol.rounds=2",
    "protocol.dialogues=3",
    "protocol.capacity=100",
    "protocol.batch_size=32",
    "protocol.eval_dialogues=4",
    "protocol.eval_every=1",
    "protocol.eval_every_dialogues=4",
    "protocol.checkpoint_every=1",
    "protocol.keep_checkpoints=last",
    "agent.hidden=[8]",
    "env=chain",
    "env.length=5",
    "spike=none",
    "replicas=2",
)
