"""The cases of the adversary tests, and their counts.

Environment variables set the counts, ``BBQ_KILLS`` (10) and ``BBQ_DAMAGES`` (50), and ``BBQ_SEED``,
the seed of all moments, damages and choices. By default every run has a new seed, which is printed
when a test fails.
"""

import os
import time

import tiny

KILLS = int(os.environ.get("BBQ_KILLS", "10"))
DAMAGES = int(os.environ.get("BBQ_DAMAGES", "50"))
SEED = int(os.environ.get("BBQ_SEED", "0")) or time.time_ns() % 2**32
os.environ["BBQ_SEED"] = str(SEED)  # the workers of pytest-xdist inherit it

TINY = (
    *tiny.TINY,
    "protocol.rounds=4",
    "protocol.batch_size=8",
    "protocol.freezes=1",
    "protocol.epochs=1",
    "protocol.eval_every=2",
    "protocol.checkpoint_every=2",
)
CONFIGURATIONS = {
    "bbqn": ("agent=bbqn", "env=domain_ext", "env.start=1", "env.every=1"),
    "replicas": ("agent=bbqn", "explore=thompson_epsilon", "replicas=3"),
    "bootstrap": ("agent=bootstrap",),
    "vime": ("agent=dqn", "intrinsic=vime", "intrinsic.hidden=[8]"),
    "boltzmann": (
        "agent=dqn",
        "explore=boltzmann",
        "env.max_turn=40",  # so that some succeed
    ),
}
CONFIGURATIONS = {name: (*TINY, *keys) for name, keys in CONFIGURATIONS.items()}
