"""Evaluations that would take longer than the training between them.

The table tests/adversary/bad_input.yaml has all other refusals.
"""

from __future__ import annotations

import pytest

from bbq_torchrl.runs.compose import compose
from bbq_torchrl.settings import ConfigError

COSTLY = ["protocol.rounds=30", "protocol.dialogues=50", "protocol.batch_size=32"]
COSTLY += ["protocol.capacity=640", "protocol.freezes=1", "protocol.epochs=2", "env.max_turn=38"]


@pytest.mark.parametrize(
    ("choices", "cost", "a_round"),
    [
        # 20 steps of 200 + 3,000 dialogues; a round: 20 steps of 200 + 50, 40 updates of 200 + 32.
        (["protocol.eval_batch=3000"], 64_000, 14_280),
        # Three replicas of 3,000, 800 at a time: four times 20 steps.
        (["protocol.eval_batch=2400", "replicas=3"], 208_000, 18_840),
    ],
)
def test_evaluations_that_take_longer_than_training_are_refused_with_the_numbers(
    choices, cost, a_round
):
    choices = [*COSTLY, *choices, "protocol.eval_every_dialogues=3000"]
    enough = -(-cost // a_round)
    compose([*choices, f"protocol.eval_every={enough}"])
    with pytest.raises(ConfigError) as refused:
        compose([*choices, f"protocol.eval_every={enough - 1}"])
    message = str(refused.value)
    assert f"must be 0 or at least {enough} with protocol.eval_every_dialogues=3000" in message
    assert f"got {enough - 1}: an evaluation would" in message
    assert f"({cost:,} against {(enough - 1) * a_round:,}, where" in message


@pytest.mark.parametrize(
    "choices",
    [
        ["protocol.eval_every=0"],  # never
        ["protocol.eval_every=31"],  # not in this training
    ],
)
def test_an_evaluation_that_never_is_costs_nothing(choices):
    compose([*COSTLY, *choices, "protocol.eval_every_dialogues=100000"])
