"""The TD loss under torch.func transforms, against autograd and a loop."""

from __future__ import annotations

from typing import get_args

import pytest
import torch
from torch.func import grad, vmap

from bbq_torchrl.objectives.td_loss import Distance, td_loss


def batch():
    """Actions, targets and weights of rows of two replicas; one row has no weight."""
    index, weight = torch.randint(4, (2, 6, 1)), torch.rand(2, 6, 1, dtype=torch.double)
    target = 3 * torch.randn(2, 6, 1, dtype=torch.double)
    weight[:, 1], target[:, 1] = 0, torch.nan
    return index, target, weight


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("distance", get_args(Distance))
def test_gradients_are_autograds_and_none_for_targets_and_what_is_reported(distance, weighted):
    index, target, weight = batch()
    if not weighted:
        target, weight = target.nan_to_num(), None
    scale = torch.tensor([0.5, 3.0], dtype=torch.double)
    values = torch.randn(2, 6, 4).double().requires_grad_()

    def outputs(values, target):
        loss, *reported = td_loss(values, index, target, weight, distance, scale)
        return loss.sum(), sum(out.sum() for out in reported)

    (by_autograd,) = torch.autograd.grad(outputs(values, target)[0], values)
    given = values.detach()
    slope, reported = grad(outputs, has_aux=True)(given, target)
    torch.testing.assert_close(slope, by_autograd)
    torch.testing.assert_close(reported, outputs(given, target)[1])
    assert not grad(lambda target: outputs(given, target)[0])(target).any()
    assert not grad(lambda values: outputs(values, target)[1])(given).any()


@pytest.mark.parametrize("in_dims", [(0, 0), (0, None), (None, 0)], ids=str)
@pytest.mark.parametrize("distance", get_args(Distance))
def test_vmap_over_losses_is_a_loop(distance, in_dims):
    """Values or row weights may be shared, too."""
    index, target, weight = batch()
    values = torch.randn(3, 2, 6, 4).double()
    weights = torch.stack([weight, weight.square(), 2 * weight])
    both = list(zip((values, weights), in_dims, strict=True))
    given = [each if dim == 0 else each[0] for each, dim in both]
    repeated = [each if dim == 0 else each[:1].expand_as(each) for each, dim in both]

    def outputs(values, weight):
        def losses(values):
            loss, *reported = td_loss(values, index, target, weight, distance)
            return loss.sum(), (loss, *reported)

        return grad(losses, has_aux=True)(values)

    slopes, losses = zip(*map(outputs, *repeated), strict=True)
    slope, found = vmap(outputs, in_dims)(*given)
    torch.testing.assert_close(slope, torch.stack(slopes))
    for one, each in zip(found, zip(*losses, strict=True), strict=True):
        torch.testing.assert_close(one, torch.stack(each))


class NoGradient(torch.autograd.Function):
    @staticmethod
    def forward(ctx, loss):
        return loss.clone()

    @staticmethod
    def backward(ctx, grad):
        return None


def test_what_gives_the_loss_no_gradient_gives_the_values_none():
    index, target, weight = batch()
    values = torch.randn(2, 6, 4).double().requires_grad_()
    loss, *_ = td_loss(values, index, target, weight, "l2", 1.0)
    NoGradient.apply(loss).sum().backward()
    assert values.grad is None
