"""An evaluator in the round trainer, and the best weights that it keeps."""

from __future__ import annotations

import pytest
import torch
from torch import nn
from trainer_parts import make_trainer

from bbq_torchrl.trainers import BestWeights

RATES = [(0.1, 0.5, 0.0), (0.6, 0.2, 0.0), (0.6, 0.1, 0.0)]
RATES += [(0.3, 0.5, 0.0), (0.2, 0.7, 0.0), (0.5, 0.0, 0.0)]


def weight_of(trainer) -> torch.Tensor:
    return next(iter(trainer.policy.parameters())).detach().clone()


def test_each_replica_keeps_the_weights_of_its_own_best_round_resumed_or_not(tmp_path):
    weights = []
    for rounds in (3, 6):
        trainer = make_trainer(
            tmp_path,
            rates=RATES,
            rounds=rounds,
            callbacks=[lambda trainer, _: weights.append(weight_of(trainer))],
        )
        trainer.train(resume=rounds == 6)

    best = trainer.evaluator.best
    # The first of equals stays; a replica that never succeeds keeps what was evaluated first.
    assert best.round.tolist() == [1, 4, 0]
    assert best.success_rate.tolist() == pytest.approx([0.6, 0.7, 0.0])
    best.put_back()
    now = weight_of(trainer)
    for replica, number in enumerate((1, 4, 0)):
        assert torch.equal(now[replica], weights[number][replica])
        assert not torch.equal(now[replica], weights[5][replica])


def test_a_best_from_before_a_given_round_does_not_count():
    policy = nn.Module()
    policy.weight = nn.Parameter(torch.zeros(2, 3))
    best = BestWeights(policy, replicas=2)
    with pytest.raises(ValueError, match="no best weights before the first evaluation"):
        best.put_back()
    best.update(0, torch.tensor([0.9, 0.9]))
    nn.init.ones_(policy.weight)
    best.update(3, torch.tensor([0.1, 0.95]), since=2)
    best.update(4, torch.tensor([0.05, 0.5]), since=2)
    assert best.round.tolist() == [3, 3]
    assert best.success_rate.tolist() == pytest.approx([0.1, 0.95])
