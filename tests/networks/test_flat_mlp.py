"""FlatMLP, on a flat weight vector against one written with torch's own layers."""

import pytest
import torch
from q_transitions import plain_mlp

from bbq_torchrl.bayes import weight_scope
from bbq_torchrl.bayes.functional import FlatLayout, init_linear_, mlp
from bbq_torchrl.networks import FlatMLP

LAYOUT = FlatLayout((5, 7, 6, 3))


@pytest.mark.parametrize("replicas", [(), (1,), (4,), (2, 3)])
@pytest.mark.parametrize("batch", [(8,), (2, 4), ()])
@pytest.mark.parametrize("layout", [LAYOUT, FlatLayout((5, 3))])
def test_values_and_gradients_equal_those_of_separate_networks(replicas, batch, layout):
    x = torch.randn(*replicas, *batch, 5, dtype=torch.double, requires_grad=True)
    flat = torch.randn(*replicas, layout.numel, dtype=torch.double, requires_grad=True)
    layers = layout.unflatten(flat.reshape(-1, layout.numel))
    rows = x.reshape(len(layers[0][0]), -1, 5)
    expected = plain_mlp(rows, [(matrix, bias.unsqueeze(-2)) for matrix, bias in layers])
    out = mlp(x, flat, layout)
    torch.testing.assert_close(out, expected.reshape(*replicas, *batch, 3))
    probe = torch.randn_like(out)
    ours = torch.autograd.grad(out, (x, flat), probe)
    theirs = torch.autograd.grad(expected, (x, flat), probe.reshape(expected.shape))
    torch.testing.assert_close(ours, theirs)


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
    # units stay with probability .75 and are multiplied by 4/3: the mean has a standard error of
    # (1/3)^.5 / 20000^.5 = .0041
    assert abs(mean - 1) < 5 * 0.0041
    assert mean != 1


def test_a_start_like_torch_linear():
    layout = FlatLayout((100, 80, 50))
    flat = torch.empty(6, layout.numel)
    init_linear_(flat, layout)
    for (matrix, bias), (inputs, _) in zip(layout.unflatten(flat), layout.shapes, strict=True):
        assert max(matrix.abs().max(), bias.abs().max()) <= inputs**-0.5
        # the standard deviation of a uniform variable in ±b is b / √3; relative error about
        # (1.25 · 2 n)^-.5 < .004 of it for n ≥ 24,000 numbers
        assert abs(matrix.std() * (3 * inputs) ** 0.5 - 1) < 0.02
        assert bias.any(-1).all()
    assert not torch.equal(flat[0], flat[1])


def test_it_drops_in_training_mode_and_never_in_mode_mean():
    net, x = FlatMLP(4, 3, (32,), dropout=0.5), torch.randn(6, 4)
    mean = net(x, "mean")
    assert not torch.equal(net(x), net(x))
    with weight_scope("mean"):
        assert torch.equal(net(x), mean)
    net.eval()
    assert torch.equal(net(x), mean)
    assert not torch.equal(net(x, "draw"), net(x, "draw"))


def test_each_row_of_each_replica_drops_separate_units():
    net = FlatMLP(1, 64, (64,), replicas=(3,), dropout=0.5)
    out = net(torch.ones(3, 5, 1), "draw").flatten(0, 1)
    assert torch.unique(out, dim=0).shape[0] == 15


def test_without_dropout_no_random_number_is_drawn():
    net, x = FlatMLP(4, 3, (32,)), torch.randn(6, 4)
    state = torch.get_rng_state()
    net(x, "draw")
    assert torch.equal(torch.get_rng_state(), state)
