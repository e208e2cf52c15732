"""Whether evaluating while training would take longer than the training itself."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from bbq_torchrl.options.settings import ConfigError

if TYPE_CHECKING:
    from bbq_torchrl.options.root import Config

__all__ = ["check_evaluation"]

FIXED_ROWS = 200
"""What a step of dialogues side by side, or an update, costs before its rows, in rows.

Measured on a CPU core for BBQN and DQN, batches of 32 and 128, 50 to 1,000 dialogues, one and five
replicas: with this, the time of a step or update per row is within a factor of two of its mean.
"""


def check_evaluation(config: Config) -> None:
    """Refuses evaluations that would take longer than the rounds between them.

    Both sides are counted, not timed: every step of the dialogues that are played side by side, and
    every update, counts 200 plus its rows (dialogues or transitions, of all replicas). Dialogues
    are taken to be as long as they may be, and the buffer as full as it gets.

    Raises:
        ConfigError: with the numbers, and what would do.
    """
    protocol, replicas = config.protocol, config.replicas
    if not protocol.eval_every or protocol.eval_every > protocol.rounds:
        return
    turns = config.env.steps()
    dialogues = protocol.eval_every_dialogues
    places = min(dialogues, max(1, protocol.eval_batch // replicas))
    evaluation = math.ceil(dialogues / places) * turns * (FIXED_ROWS + replicas * places)
    stored = (config.spike.dialogues + protocol.rounds * protocol.dialogues) * turns
    batches = math.ceil(min(protocol.capacity, stored) / protocol.batch_size)
    updates = protocol.freezes * protocol.epochs * batches
    a_round = turns * (FIXED_ROWS + replicas * protocol.dialogues)
    a_round += updates * (FIXED_ROWS + replicas * protocol.batch_size)
    if evaluation <= protocol.eval_every * a_round:
        return
    raise ConfigError(
        f"protocol.eval_every must be 0 or at least {math.ceil(evaluation / a_round)} with "
        f"protocol.eval_every_dialogues={dialogues}, got {protocol.eval_every}: an evaluation of "
        f"{math.ceil(dialogues / places) * turns:,} steps with {replicas * places:,} dialogues "
        f"side by side would take longer than the training between two, of "
        f"{protocol.eval_every * turns:,} steps with {replicas * protocol.dialogues:,} and "
        f"{protocol.eval_every * updates:,} updates of {replicas * protocol.batch_size:,} "
        f"transitions ({evaluation:,} against {protocol.eval_every * a_round:,}, "
        f"where a step or an update counts {FIXED_ROWS} and its rows)"
    )
