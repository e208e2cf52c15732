"""A tiny run whose folder is damaged, copied and gone on with."""

from tiny import TINY

DQN = (
    *TINY,
    "agent=dqn",
    "explore=greedy",  # no schedule, which would fall over the share of other rounds
    "protocol.rounds=3",
    "protocol.eval_every=0",
    "protocol.checkpoint_every=10",
    "protocol.keep_checkpoints=weights",
)
