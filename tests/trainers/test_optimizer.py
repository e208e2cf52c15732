"""Adam over replicas that do not touch one another."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import nn

from bbq_torchrl.trainers import ReplicaAdam

RATES = (1e-2, 1e-2, 1e-3)


def test_steps_are_bitwise_adams_whoever_is_active_at_whatever_share_of_the_rate():
    weight, bias = nn.Parameter(torch.randn(3, 4, 5)), nn.Parameter(torch.randn(3, 7))
    twins = [[p.detach()[r].clone().requires_grad_() for p in (weight, bias)] for r in range(3)]
    ours = ReplicaAdam([weight, bias], 3, lr=RATES)
    theirs = [
        torch.optim.Adam(twin, lr=rate, fused=True) for twin, rate in zip(twins, RATES, strict=True)
    ]

    for number in range(12):
        active = (True, number % 4 != 3, number % 3 != 2)
        share = (1.0, 0.7, 0.1)[number // 4]
        gradients = [torch.randn_like(weight), torch.randn_like(bias)]
        if number % 5 == 4:
            gradients[1] = None
        for replica, (twin, adam) in enumerate(zip(twins, theirs, strict=True)):
            if active[replica]:
                adam.param_groups[0]["lr"] = RATES[replica] * share
                for own, gradient in zip(twin, gradients, strict=True):
                    own.grad = None if gradient is None else gradient[replica].clone()
                adam.step()
            else:
                gradients[0][replica] = torch.nan  # what does not concern a batch means nothing
        weight.grad, bias.grad = gradients
        ours.scale_lr(share)
        ours.step(None if all(active) else active)
        if number == 6:  # what was saved at a fallen rate goes on at whichever comes
            saved, ours = ours.state_dict(), ReplicaAdam([weight, bias], 3, lr=RATES)
            ours.load_state_dict(saved)

    for replica, twin in enumerate(twins):
        assert torch.equal(weight.detach()[replica], twin[0].detach())
        assert torch.equal(bias.detach()[replica], twin[1].detach())


def test_a_restored_state_is_a_copy():
    parameter, frozen = nn.Parameter(torch.ones(3, 4)), nn.Parameter(torch.ones(2), False)
    optimizer = ReplicaAdam([parameter, frozen], 3)  # what is frozen is left out
    parameter.grad = torch.ones(3, 4)
    optimizer.step((True, True, False))
    saved = copy.deepcopy(optimizer.state_dict())

    optimizer.load_state_dict(saved)
    assert {n: float(state["step"]) for n, state in saved["state"].items()} == {0: 1.0, 1: 1.0}
    optimizer.step()

    assert [float(state["step"]) for state in saved["state"].values()] == [1.0, 1.0]
    steps = [float(state["step"]) for state in optimizer.state_dict()["state"].values()]
    assert steps == [2.0, 2.0, 1.0]


@pytest.mark.parametrize(
    ("shapes", "rates", "message"),
    [
        ([(2, 4)], 1e-3, r"must be the 3 replicas, got shape \(2, 4\)"),
        ([], 1e-3, "got none"),
        ([(3, 1)], [0.1, 0.2], "one for each of the 3 replicas, got 2"),
    ],
)
def test_what_is_not_of_the_replicas_is_refused(shapes, rates, message):
    with pytest.raises(ValueError, match=message):
        ReplicaAdam([nn.Parameter(torch.zeros(shape)) for shape in shapes], 3, lr=rates)
