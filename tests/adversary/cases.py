"""What is tried, and how often.

The environment has the counts, ``BBQ_KILLS`` (10), ``BBQ_DAMAGES`` (50) and ``BBQ_INPUTS`` (45
rows of the table of bad inputs), and ``BBQ_SEED``, the seed of all moments, damages and choices:
where it is not given, another one in every run, which is printed where a test fails.
"""

from __future__ import annotations

import os
import time

KILLS = int(os.environ.get("BBQ_KILLS", "10"))
DAMAGES = int(os.environ.get("BBQ_DAMAGES", "50"))
INPUTS = int(os.environ.get("BBQ_INPUTS", "45"))
SEED = int(os.environ.get("BBQ_SEED", "0")) or time.time_ns() % 2**32
os.environ["BBQ_SEED"] = str(SEED)  # the workers of pytest-xdist inherit it

TINY = (
    "protocol.rounds=4",
    "protocol.dialogues=3",
    "protocol.batch_size=8",
    "protocol.freezes=1",
    "protocol.epochs=1",
    "protocol.capacity=150",
    "protocol.eval_dialogues=4",
    "protocol.eval_batch=4",
    "protocol.eval_every=2",
    "protocol.eval_every_dialogues=2",
    "protocol.checkpoint_every=2",
    "protocol.keep_checkpoints=last",
)
SPIKE = ("spike.dialogues=3",)
CONFIGURATIONS = {
    "bbqn": ("agent=bbqn", "agent.hidden=[8]", "env=domain_ext", "env.start=1", "env.every=1"),
    "replicas": ("agent=bbqn", "agent.hidden=[8]", "explore=thompson_epsilon", "replicas=3"),
    "bootstrap": ("agent=bootstrap", "agent.hidden=[8]"),
    "vime": ("agent=dqn", "agent.hidden=[8]", "intrinsic=vime", "intrinsic.hidden=[8]"),
    "boltzmann": ("agent=dqn", "agent.hidden=[8]", "explore=boltzmann", "spike.drop_above=.01"),
}
CONFIGURATIONS = {name: (*keys, *SPIKE, *TINY) for name, keys in CONFIGURATIONS.items()}
