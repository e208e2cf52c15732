"""The weights that each replica had at its best; in a training: tests/evaluation."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from bbq_torchrl.trainers import BestWeights

RATES = [(0.1, 0.5, 0.0), (0.6, 0.2, 0.0), (0.6, 0.1, 0.0)]
RATES += [(0.3, 0.5, 0.0), (0.2, 0.7, 0.0), (0.5, 0.0, 0.0)]


def new(weight: float = 0.0) -> tuple[nn.Module, BestWeights]:
    policy = nn.Module()
    policy.weight = nn.Parameter(torch.full((3, 2), weight))
    return policy, BestWeights(policy, replicas=3)


def test_each_replica_keeps_the_weights_of_its_own_best_round_resumed_or_not():
    policy, best = new()
    with pytest.raises(ValueError, match="no best weights before the first evaluation"):
        best.put_back()
    for number, rates in enumerate(RATES):
        nn.init.constant_(policy.weight, float(number))
        best.update(number, torch.tensor(rates))
        if number == 2:
            state = best.state_dict()
            policy, best = new()
            best.load_state_dict(state)

    # The first of equals stays; a replica that never succeeds keeps what was evaluated first.
    assert best.round.tolist() == [1, 4, 0]
    assert best.success_rate.tolist() == pytest.approx([0.6, 0.7, 0.0])
    best.put_back()
    assert policy.weight.tolist() == [[1.0, 1.0], [4.0, 4.0], [0.0, 0.0]]


def test_a_best_from_before_a_given_round_does_not_count():
    _, best = new()
    best.update(0, torch.tensor([0.9, 0.9, 0.9]))
    best.update(3, torch.tensor([0.1, 0.95, 0.0]), since=2)
    best.update(4, torch.tensor([0.05, 0.5, 0.0]), since=2)
    assert best.round.tolist() == [3, 3, 3]
    assert best.success_rate.tolist() == pytest.approx([0.1, 0.95, 0.0])
