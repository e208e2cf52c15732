"""FlatMLP, on a flat weight vector against one written with torch's own layers."""

from __future__ import annotations

import pytest
import torch
from q_transitions import plain_mlp

from bbq_torchrl.bayes import BayesMLP, weight_scope
from bbq_torchrl.bayes.functional import FlatLayout, init_linear_, mlp
from bbq_torchrl.networks import FlatMLP

LAYOUT = FlatLayout((5, 7, 6, 3))
REPLICAS = [(), (1,), (4,), (2, 3)]


def per_element(x, flat, replicas, layout):
    outs = [
        plain_mlp(a, layout.unflatten(b))
        for a, b in zip(
            x.reshape(-1, *x.shape[len(replicas) :]), flat.reshape(-1, flat.shape[-1]), strict=True
        )
    ]
    return torch.stack(outs).reshape(*replicas, *outs[0].shape)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("batch", [(8,), (2, 4), ()])
@pytest.mark.parametrize("layout", [LAYOUT, FlatLayout((5, 3))])
def test_values_and_gradients_equal_those_of_separate_networks(replicas, batch, layout):
    x = torch.randn(*replicas, *batch, 5, dtype=torch.double, requires_grad=True)
    flat = torch.randn(*replicas, layout.numel, dtype=torch.double, requires_grad=True)
    out, expected = mlp(x, flat, layout), per_element(x, flat, replicas, layout)
    assert out.shape == (*replicas, *batch, 3)
    torch.testing.assert_close(out, expected)
    probe = torch.randn_like(out)
    for ours, theirs in zip(
        torch.autograd.grad(out, (x, flat), probe),
        torch.autograd.grad(expected, (x, flat), probe),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("kind", [FlatMLP, BayesMLP])
def test_a_second_derivative_is_taken_by_torch_func_and_else_refused(kind):
    network, x = kind(5, 3, (64,)), torch.randn(5)
    with torch.no_grad():
        next(network.parameters()).normal_()
    with pytest.raises(RuntimeError, match=r"written by hand .* by torch\.func"):
        torch.autograd.grad(network(x.requires_grad_()).sum(), x, create_graph=True)
    hessian = torch.func.hessian(lambda x: network(x).pow(2).sum())(x.detach())
    assert hessian.abs().max() > 0


def test_gradcheck_with_dropout():
    x = torch.randn(2, 6, 5, dtype=torch.double, requires_grad=True)
    flat = torch.randn(2, LAYOUT.numel, dtype=torch.double, requires_grad=True)

    def same_masks(a, b):
        torch.manual_seed(3)
        return mlp(a, b, LAYOUT, dropout=0.4)

    assert torch.autograd.gradcheck(same_masks, (x, flat))


def test_dropout_drops_the_given_share_and_keeps_the_mean():
    layout = FlatLayout((1, 20_000, 1))
    flat = torch.zeros(layout.numel)
    (_, hidden_bias), (out, _) = layout.unflatten(flat)
    hidden_bias.fill_(1.0)
    out.fill_(1 / 20_000)  # the output is the mean of the hidden units
    mean = mlp(torch.zeros(1, 1), flat, layout, dropout=0.25).item()
    # kept with .75, then 4/3: the mean's standard error is (1/3)^.5 / 20000^.5 = .0041
    assert abs(mean - 1) < 5 * 0.0041
    assert mean != 1


def test_dropout_masks_differ_between_rows_and_elements():
    net = FlatMLP(1, 64, (64,), replicas=(3,), dropout=0.5)
    out = net(torch.ones(3, 5, 1), "draw").flatten(0, 1)
    assert torch.unique(out, dim=0).shape[0] == 15


def test_a_start_like_torch_linear():
    layout = FlatLayout((100, 80, 50))
    flat = torch.empty(6, layout.numel)
    init_linear_(flat, layout)
    for (matrix, bias), (inputs, _) in zip(layout.unflatten(flat), layout.shapes, strict=True):
        for part in (matrix, bias):
            assert part.abs().max() <= inputs**-0.5
        # the standard deviation of a uniform variable in ±b is b / √3; relative error about
        # (1.25 · 2 n)^-.5 < .004 of it for n ≥ 24,000 numbers
        assert abs(matrix.std() * (3 * inputs) ** 0.5 - 1) < 0.02
    assert not torch.equal(flat[0], flat[1])


def test_mlp_drops_in_training_mode_and_never_in_mode_mean():
    net, x = FlatMLP(4, 3, (32,), dropout=0.5), torch.randn(6, 4)
    assert not torch.equal(net(x), net(x))
    assert torch.equal(net(x, "mean"), net(x, "mean"))
    with weight_scope("mean"):
        assert torch.equal(net(x), net(x, "mean"))
    net.eval()
    assert torch.equal(net(x), net(x, "mean"))
    assert not torch.equal(net(x, "draw"), net(x, "draw"))


def test_mlp_without_dropout_draws_no_random_number():
    net, x = FlatMLP(4, 3, (32,)), torch.randn(6, 4)
    state = torch.get_rng_state()
    net(x, "draw")
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize("dropout", [-0.1, 1.0, 2.0])
def test_a_dropout_outside_of_its_range_is_refused(dropout):
    with pytest.raises(ValueError, match=r"dropout must be in \[0, 1\), got"):
        FlatMLP(3, 2, dropout=dropout)


@pytest.mark.parametrize("shape", [(7, 5), (4, 8), (5,)])
def test_an_input_whose_shape_does_not_fit_is_refused(shape):
    flat = torch.randn(4, LAYOUT.numel)
    with pytest.raises(ValueError, match=r"input must have shape \[4, \*batch, 5\], got"):
        mlp(torch.randn(shape), flat, LAYOUT)


def test_sizes_that_are_no_network_are_refused():
    for sizes in [(3,), (3, 0, 2), (-1, 2)]:
        with pytest.raises(ValueError, match="sizes must be at least two positive integers"):
            FlatLayout(sizes)
