"""A loss on a network's values inside of torch.func: as by autograd and by a loop."""

from __future__ import annotations

import pytest
import torch
from q_transitions import FixedNoise
from torch.func import functional_call, grad, vmap

from bbq_torchrl.bayes import BayesMLP, weight_scope
from bbq_torchrl.objectives.td_loss import DISTANCES, td_loss


def batch(with_weight):
    index = torch.randint(4, (2, 6, 1))
    target = 3 * torch.randn(2, 6, 1, dtype=torch.double)
    weight = None
    if with_weight:
        weight = torch.rand(2, 6, 1, dtype=torch.double)
        weight[:, 1] = 0
        target[:, 1] = torch.nan
    return index, target, weight


@pytest.mark.parametrize("with_weight", [False, True], ids=["all rows", "weighted rows"])
@pytest.mark.parametrize("distance", DISTANCES)
def test_the_gradient_of_a_loss_is_autograds(distance, with_weight):
    net = BayesMLP(5, 4, (7,), replicas=2, std_init=0.2, dtype=torch.double)
    x, noise = torch.randn(2, 6, 5).double(), torch.randn_like(net.posterior.mu)
    scale = torch.tensor([0.5, 3.0], dtype=torch.double)
    rows = batch(with_weight)

    def value(parameters):
        with weight_scope("draw", noise=FixedNoise(noise), kl="closed") as scope:
            values = functional_call(net, parameters, (x,))
        loss, *reported = td_loss(values, *rows, distance, scale)
        return (loss + scope.kl.total() / 100).sum(), reported

    parameters = dict(net.named_parameters())
    expected, expected_reported = value(parameters)
    by_autograd = torch.autograd.grad(expected, list(parameters.values()))
    found, reported = grad(value, has_aux=True)(parameters)
    torch.testing.assert_close(list(found.values()), list(by_autograd))
    torch.testing.assert_close(reported, expected_reported)


@pytest.mark.parametrize("distance", DISTANCES)
def test_a_target_and_what_is_reported_pass_no_gradient_on(distance):
    index, target, _ = batch(with_weight=False)
    values = torch.randn(2, 6, 4).double()
    by_target = grad(lambda y: td_loss(values, index, y, None, distance)[0].sum())(target)
    assert not by_target.any()

    def reported(v):
        return sum(out.sum() for out in td_loss(v, index, target, None, distance)[1:])

    assert not grad(reported)(values).any()


@pytest.mark.parametrize("of", ["values", "weight", "both"])
@pytest.mark.parametrize("distance", DISTANCES)
def test_vmap_over_losses_is_a_loop(distance, of):
    """Also where all share the values, or the weights of the rows."""
    index, target, weight = batch(with_weight=True)
    values = torch.randn(3, 2, 6, 4).double()
    weights = torch.stack([weight, weight.square(), 2 * weight])
    if of == "values":
        weights = weights[:1].expand(3, -1, -1, -1)
    if of == "weight":
        values = values[:1].expand(3, -1, -1, -1)
    in_dims = (None if of == "weight" else 0, None if of == "values" else 0)
    given = (values[0] if of == "weight" else values, weights[0] if of == "values" else weights)

    def slope(v, w):
        return grad(lambda v: td_loss(v, index, target, w, distance)[0].sum())(v)

    def losses(v, w):
        return td_loss(v, index, target, w, distance)

    found = vmap(losses, in_dims)(*given)
    pairs = list(zip(values, weights, strict=True))
    expected = [torch.stack(outs) for outs in zip(*(losses(*pair) for pair in pairs), strict=True)]
    torch.testing.assert_close(list(found), expected)
    loop = []
    for v, w in pairs:
        v = v.clone().requires_grad_()
        loop += torch.autograd.grad(losses(v, w)[0].sum(), v)
    torch.testing.assert_close(vmap(slope, in_dims)(*given), torch.stack(loop))
