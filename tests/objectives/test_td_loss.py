"""The TD loss under torch.func transforms, against autograd and a loop."""

from typing import get_args

import pytest
import torch
from torch.func import grad

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
