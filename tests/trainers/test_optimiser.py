"""Adam over replicas that do not touch one another."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import nn

from bbq_torchrl.trainers import ReplicaAdam

SHAPES = [(3, 4, 5), (3, 7)]


def replica_parameters() -> list[nn.Parameter]:
    generator = torch.Generator().manual_seed(0)
    return [nn.Parameter(torch.randn(shape, generator=generator)) for shape in SHAPES]


def give_gradients(parameters: list[nn.Parameter], step: int) -> None:
    generator = torch.Generator().manual_seed(100 + step)
    for parameter in parameters:
        parameter.grad = torch.randn(parameter.shape, generator=generator)


# Which replicas are active in each of the steps.
FLAGS = [(True, True, True), (True, False, True), (False, False, True), (True, True, False)] * 3


def test_a_scaled_rate_is_torchs_schedule():
    shares = [1.0, 1.0, 0.7, 0.1, 0.4]
    rates = (1e-2, 1e-2, 0.3)
    parameters, alone = replica_parameters(), [replica_parameters() for _ in rates]
    adams = [torch.optim.Adam(alone[r], lr=rate) for r, rate in enumerate(rates)]
    schedules = [torch.optim.lr_scheduler.LambdaLR(adam, shares.__getitem__) for adam in adams]
    optimizer = ReplicaAdam(parameters, 3, lr=rates)
    for number, share in enumerate(shares):
        optimizer.scale_lr(share)
        give_gradients(parameters, number)
        optimizer.step()
        for r, (adam, schedule) in enumerate(zip(adams, schedules, strict=True)):
            give_gradients(alone[r], number)
            adam.step()
            if number + 1 < len(shares):
                schedule.step()
            for own, stacked in zip(alone[r], parameters, strict=True):
                torch.testing.assert_close(own[r], stacked[r], rtol=1e-6, atol=1e-7)
        if number == 2:  # what was saved under a fallen rate goes on with whichever comes
            saved = optimizer.state_dict()
            optimizer = ReplicaAdam(parameters, 3, lr=rates)
            optimizer.load_state_dict(saved)


def test_as_many_rates_as_replicas_or_one():
    with pytest.raises(ValueError, match="one for each of the 3 replicas, got 2"):
        ReplicaAdam(replica_parameters(), 3, lr=[0.1, 0.2])


def test_an_inactive_replica_is_bitwise_untouched():
    parameters = replica_parameters()
    optimizer = ReplicaAdam(parameters, 3, lr=1e-2)
    give_gradients(parameters, 0)
    optimizer.step()
    before = [p.detach().clone() for p in parameters]
    give_gradients(parameters, 1)
    for parameter in parameters:
        parameter.grad[1] = torch.nan

    optimizer.step((True, False, True))

    for old, parameter in zip(before, parameters, strict=True):
        assert torch.equal(old[1], parameter[1])
        assert not torch.equal(old[0], parameter[0])
        assert parameter.isfinite().all()


def test_frozen_parameters_are_left_out():
    frozen = nn.Parameter(torch.zeros(2), requires_grad=False)

    assert ReplicaAdam([nn.Parameter(torch.zeros(3, 1)), frozen], 3).parameters[0].shape == (3, 1)


def test_parameters_without_replicas_are_refused():
    with pytest.raises(ValueError, match=r"must be the 3 replicas, got shape \(2, 4\)"):
        ReplicaAdam([nn.Parameter(torch.zeros(2, 4))], 3)
    with pytest.raises(ValueError, match="got none"):
        ReplicaAdam([], 3)


def test_a_restored_state_is_a_copy():
    parameters = [nn.Parameter(torch.ones(3, 4))]
    optimizer = ReplicaAdam(parameters, 3)
    start = optimizer.state_dict()

    def step(active):
        parameters[0].grad = torch.ones(3, 4)
        optimizer.step(active)

    step((True, True, False))
    saved = copy.deepcopy(optimizer.state_dict())
    for state, expected in ((saved, {0: 1.0, 1: 1.0}), (start, {})):
        optimizer.load_state_dict(state)
        steps = {n: float(s["step"]) for n, s in optimizer.state_dict()["state"].items()}
        assert steps == expected
        step((True, True, True))
    assert [float(s["step"]) for s in saved["state"].values()] == [1.0, 1.0]


def test_steps_are_bitwise_adams_with_and_without_inactive_replicas_between():
    weight = nn.Parameter(torch.randn(3, 50))
    bias = nn.Parameter(torch.randn(3, 7))
    twins = [[p.detach()[r].clone().requires_grad_() for p in (weight, bias)] for r in range(3)]
    ours = ReplicaAdam([weight, bias], 3, lr=[1e-2, 1e-2, 1e-3])
    theirs = [
        torch.optim.Adam(twin, lr=lr, fused=True)
        for twin, lr in zip(twins, (1e-2, 1e-2, 1e-3), strict=True)
    ]

    for number in range(12):
        active = (True, number % 4 != 3, True)
        has_bias = number % 5 != 4
        weight.grad, bias.grad = torch.randn(3, 50), torch.randn(3, 7) if has_bias else None
        for replica, (twin, adam) in enumerate(zip(twins, theirs, strict=True)):
            if active[replica]:
                twin[0].grad = weight.grad[replica].clone()
                twin[1].grad = bias.grad[replica].clone() if has_bias else None
                adam.step()
        ours.step(active)
        if number == 6:
            ours.load_state_dict(ours.state_dict())

    for replica, twin in enumerate(twins):
        assert torch.equal(weight.detach()[replica], twin[0].detach())
        assert torch.equal(bias.detach()[replica], twin[1].detach())
