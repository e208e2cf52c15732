"""What happens in one replica leaves the others' weights bitwise unchanged."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from trainer_parts import make_trainer

from bbq_torchrl.trainers import RoundTrainer, TrainingError


def weights(trainer: RoundTrainer) -> Tensor:
    (weight,) = trainer.optimizer.parameters
    return weight.detach().clone()


def drop_the_spike(trainer: RoundTrainer, _: object) -> None:
    """A callback: has replica 0 lose its spike after the second round."""
    if trainer.rounds_done == 2:
        trainer.replay.drop_protected(0)


@pytest.mark.parametrize("capacity", [70, 1000])
def test_what_one_replica_does_leaves_the_others_bitwise_alone(tmp_path, capacity):
    """With buffers that stay ragged (1000), and that fill up and evict (70)."""
    trainers = []
    for name in ("as it is", "changed"):
        trainer = make_trainer(tmp_path / name, rounds=5, capacity=capacity)
        with torch.no_grad():  # all begin alike: only their random numbers tell them apart
            trainer.optimizer.parameters[0].copy_(trainer.optimizer.parameters[0][:1].clone())
        if name == "changed":  # Never guesses: longer dialogues, and longer epochs.
            trainer.callbacks = (drop_the_spike,)
            with torch.no_grad():
                trainer.optimizer.parameters[0][0, :, 0] -= 100.0
        trainer.train()
        trainers.append(trainer)
    plain, changed = trainers

    assert torch.equal(weights(plain)[1:], weights(changed)[1:])
    assert not torch.equal(weights(plain)[0], weights(changed)[0])
    assert not torch.equal(weights(plain)[0], weights(plain)[1])
    for ours, theirs in zip(plain.metrics.rows, changed.metrics.rows, strict=True):
        for name in ("success_rate", "reward", "turns", "loss", "q_value", "buffer", "updates"):
            assert ours["replica"] == 0 or ours[name] == theirs[name]
    # The test means something only if replica 0's epochs differ in length.
    lengths = [[r["updates"] for r in t.metrics.rows if r["replica"] == 0] for t in trainers]
    assert lengths[0] != lengths[1]


def test_the_others_finish_the_round_in_which_one_breaks(tmp_path):
    plain, broken = (make_trainer(tmp_path / name, rounds=1) for name in ("plain", "broken"))
    with torch.no_grad():
        broken.optimizer.parameters[0][0, 1, 1] = torch.nan
    plain.train()

    with pytest.raises(TrainingError, match="replica 0 is not finite in round 0"):
        broken.train()

    assert torch.equal(weights(plain)[1:], weights(broken)[1:])
