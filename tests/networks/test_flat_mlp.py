"""FlatMLP and the network with heads against separate ones written with torch's layers."""

import pytest
import torch
from q_transitions import REPLICAS, plain_mlp

from bbq_torchrl.bayes.functional import FlatLayout, init_linear_, mlp
from bbq_torchrl.networks import BootstrapMLP, FlatMLP

LAYOUT = FlatLayout((5, 7, 6, 3))


def test_gradcheck_with_dropout():
    x = torch.randn(2, 2, 5, dtype=torch.double, requires_grad=True)
    flat = torch.randn(2, LAYOUT.numel, dtype=torch.double, requires_grad=True)

    def same_masks(a, b):
        torch.manual_seed(3)
        return mlp(a, b, LAYOUT, dropout=0.4)

    assert torch.autograd.gradcheck(same_masks, (x, flat))


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
    net.eval()
    assert torch.equal(net(x), mean)
    assert not torch.equal(net(x, "draw"), net(x, "draw"))


def test_each_row_of_each_replica_drops_separate_units():
    net = FlatMLP(1, 64, (64,), replicas=(3,), dropout=0.5)
    out = net(torch.ones(3, 5, 1), "draw").flatten(0, 1)
    assert torch.unique(out, dim=0).shape[0] == 15


FEATURES, OUT, HIDDEN, HEADS = 5, 3, (7, 6), 4


def make(replicas=(), **settings):
    settings = {"heads": HEADS, "dtype": torch.double, **settings}
    return BootstrapMLP(FEATURES, OUT, HIDDEN, replicas=replicas, **settings)


def by_definition(net, x, trunk, heads):
    """Plain networks with these weights, one for each head of each replica."""
    layers = net.head_layout.unflatten(heads.reshape(-1, HEADS, heads.shape[-1]))
    if trunk is not None:
        layers = net.trunk_layout.unflatten(trunk.reshape(-1, 1, trunk.shape[-1])) + layers
    rows = x.reshape(net.replicas.numel(), 1, -1, FEATURES)
    out = plain_mlp(rows, [(matrix, bias.unsqueeze(-2)) for matrix, bias in layers])
    return out.movedim(1, -2).reshape(*x.shape[:-1], HEADS, OUT)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("trunk_layers", [0, 1, 2])
@pytest.mark.parametrize("batch", [(8,), (2, 4), ()])
@pytest.mark.parametrize("prior_scale", [0.0, 3.0])
def test_heads_are_networks_that_share_a_trunk_and_pass_it_the_mean_of_their_gradients(
    replicas, trunk_layers, batch, prior_scale
):
    net = make(replicas, trunk_layers=trunk_layers, prior_scale=prior_scale)
    x = torch.randn(*replicas, *batch, FEATURES, dtype=torch.double, requires_grad=True)
    out, expected = net(x), by_definition(net, x, net.trunk, net.heads)
    if prior_scale:
        expected = expected + prior_scale * by_definition(net, x, net.prior_trunk, net.prior_heads)
    torch.testing.assert_close(out, expected)

    probe = torch.randn_like(out)
    shared = [x] if net.trunk is None else [x, net.trunk]
    of_heads, *of_shared = torch.autograd.grad(out, [net.heads, *shared], probe)
    heads_expected, *shared_expected = torch.autograd.grad(expected, [net.heads, *shared], probe)
    torch.testing.assert_close(of_heads, heads_expected)
    for ours, theirs in zip(of_shared, shared_expected, strict=True):
        torch.testing.assert_close(ours, theirs / HEADS if trunk_layers else theirs)


def test_every_head_of_every_replica_starts_with_separate_weights():
    net = make((3,), prior_scale=1.0)
    heads = torch.cat([net.heads.detach().flatten(0, 1), net.prior_heads.flatten(0, 1)])
    assert torch.unique(heads, dim=0).shape[0] == 2 * 3 * HEADS
    trunks = torch.cat([net.trunk.detach(), net.prior_trunk])
    assert torch.unique(trunks, dim=0).shape[0] == 6
