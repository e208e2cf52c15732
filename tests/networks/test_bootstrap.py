"""The network with bootstrap heads against K separate ones, and its priors."""

from __future__ import annotations

import pytest
import torch
from q_transitions import REPLICAS, plain_mlp
from torch.func import functional_call, grad, stack_module_state, vmap

from bbq_torchrl.networks import BootstrapMLP, FlatMLP

FEATURES, OUT, HIDDEN, HEADS = 5, 3, (7, 6), 4
TRUNKS = [0, 1, 2]


def make(replicas=(), trunk_layers=None, **settings):
    settings = {"heads": HEADS, "dtype": torch.double, **settings}
    return BootstrapMLP(
        FEATURES, OUT, HIDDEN, replicas=replicas, trunk_layers=trunk_layers, **settings
    )


def separate_networks(x, trunk, heads, net):
    """Each head of each replica, one after the other: [*replicas, *batch, K, out]."""
    n = len(net.replicas)
    x = x.reshape(-1, *x.shape[n:])
    heads = heads.reshape(-1, net.num_heads, heads.shape[-1])
    outs = []
    for element, (rows, of_heads) in enumerate(zip(x, heads, strict=True)):
        shared = []
        if net.trunk_layout is not None:
            flat = trunk.reshape(-1, trunk.shape[-1])[element]
            shared = net.trunk_layout.unflatten(flat)
        layers = [shared + net.head_layout.unflatten(head) for head in of_heads]
        outs.append(torch.stack([plain_mlp(rows, each) for each in layers], -2))
    out = torch.stack(outs)
    return out.reshape(*net.replicas, *out.shape[1:])


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("trunk_layers", TRUNKS)
@pytest.mark.parametrize("batch", [(8,), (2, 4), ()])
def test_outputs_are_those_of_separate_networks_that_share_a_trunk(replicas, trunk_layers, batch):
    net = make(replicas, trunk_layers)
    x = torch.randn(*replicas, *batch, FEATURES, dtype=torch.double)
    out = net(x)
    assert out.shape == (*replicas, *batch, HEADS, OUT)
    torch.testing.assert_close(out, separate_networks(x, net.trunk, net.heads, net))


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("trunk_layers", TRUNKS)
def test_heads_get_their_own_gradient_and_the_trunk_the_mean_of_theirs(replicas, trunk_layers):
    net = make(replicas, trunk_layers)
    x = torch.randn(*replicas, 8, FEATURES, dtype=torch.double, requires_grad=True)
    probe = torch.randn(*replicas, 8, HEADS, OUT, dtype=torch.double)
    wanted = [x, net.heads] + ([] if net.trunk is None else [net.trunk])
    gradients = torch.autograd.grad((net(x) * probe).sum(), wanted)

    reference = separate_networks(x, net.trunk, net.heads, net)
    per_head = [
        torch.autograd.grad(
            (reference * probe)[..., k, :].sum(), wanted, retain_graph=True, materialize_grads=True
        )
        for k in range(HEADS)
    ]
    of_x, of_heads, *of_trunk = (torch.stack(parts) for parts in zip(*per_head, strict=True))
    torch.testing.assert_close(gradients[1], of_heads.sum(0))
    if trunk_layers:
        torch.testing.assert_close(gradients[2], of_trunk[0].mean(0))
        torch.testing.assert_close(gradients[0], of_x.mean(0))
    else:  # nothing is shared
        assert net.trunk is None
        torch.testing.assert_close(gradients[0], of_x.sum(0))


def test_every_head_of_every_element_starts_with_weights_of_its_own():
    net = make((3,), prior_scale=1.0)
    heads = torch.cat([net.heads.detach().flatten(0, 1), net.prior_heads.flatten(0, 1)])
    assert torch.unique(heads, dim=0).shape[0] == 2 * 3 * HEADS
    trunks = torch.cat([net.trunk.detach(), net.prior_trunk])
    assert torch.unique(trunks, dim=0).shape[0] == 6


@pytest.mark.parametrize("trunk_layers", TRUNKS)
def test_the_prior_is_another_network_times_its_scale(trunk_layers):
    net = make((2,), trunk_layers, prior_scale=3.0)
    x = torch.randn(2, 8, FEATURES, dtype=torch.double)
    expected = separate_networks(x, net.trunk, net.heads, net)
    prior = separate_networks(x, net.prior_trunk, net.prior_heads, net)
    assert prior.std() > 0
    torch.testing.assert_close(net(x), expected + 3.0 * prior)


def test_without_a_prior_there_is_no_memory_for_one():
    assert not list(make().named_buffers())
    assert set(make().state_dict()) == {"trunk", "heads"}
    assert set(make(trunk_layers=0).state_dict()) == {"heads"}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"heads": 0}, "heads must be at least 1, got 0"),
        ({"trunk_layers": 3}, "trunk_layers must be from 0 to 2, the number of hidden layers, got"),
        ({"prior_scale": float("nan")}, "prior_scale must be at least 0 and finite, got nan"),
    ],
)
def test_settings_outside_of_what_is_listed_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        make(**settings)


def test_shapes_that_do_not_fit_are_refused():
    for trunk_layers in TRUNKS:
        net = make((3,), trunk_layers)
        for shape in [(2, 8, FEATURES), (3, 8, FEATURES + 1), (3,), (FEATURES,)]:
            with pytest.raises(ValueError, match=r"input must have shape \[3, \*batch, 5\], got"):
                net(torch.randn(shape, dtype=torch.double))


def flat_mlp(replicas, **_):
    return FlatMLP(FEATURES, OUT, HIDDEN, replicas=replicas, dtype=torch.double)


@pytest.mark.parametrize("replicas", [(), (2,)])
@pytest.mark.parametrize("make", [make, flat_mlp])
def test_gradients_and_loops_by_torch_func_are_autograds(make, replicas):
    nets = [make(replicas, trunk_layers=1, prior_scale=0.5) for _ in range(3)]
    x = torch.randn(*replicas, 8, FEATURES, dtype=torch.double)

    def value(parameters, buffers):
        return functional_call(nets[0], (parameters, buffers), (x,)).square().sum()

    params, buffers = stack_module_state(nets)
    found = vmap(grad(value))(params, buffers)
    for number, net in enumerate(nets):
        net(x).square().sum().backward()
        for name, parameter in net.named_parameters():
            torch.testing.assert_close(found[name][number], parameter.grad)
