"""NoisyMLP against TorchRL's NoisyLinear: outputs, replicas, modes, states."""

from __future__ import annotations

import pytest
import torch
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import NoisyLinear, reset_noise

from bbq_torchrl.bayes import weight_scope
from bbq_torchrl.networks import NoisyMLP, ReplicaNoisyLinear

RANDOM = ExplorationType.RANDOM
REPLICAS = [(), (1,), (3,), (2, 3)]
BATCHES = [(), (6,), (2, 4)]


@pytest.fixture
def noise(monkeypatch):
    """Records the noise vectors of calls, in order."""
    drawn, scale = [], NoisyLinear._scale_noise

    def record(self, size):
        drawn.append(scale(self, size))
        return drawn[-1]

    monkeypatch.setattr(ReplicaNoisyLinear, "_scale_noise", record)
    return drawn


def torchrl_networks(net):
    """One network of TorchRL's own layers for each replica, same parameters."""
    made = []
    for k in range(net.replicas.numel()):
        layers = []
        for layer in net.layers:
            theirs = NoisyLinear(layer.in_features, layer.out_features, dtype=torch.double)
            for name, parameter in layer.named_parameters():
                own = parameter.detach().reshape(-1, *getattr(theirs, name).shape)[k]
                getattr(theirs, name).data.copy_(own)
            layers += [theirs, nn.ReLU()]
        made.append(nn.Sequential(*layers[:-1]))
    return made


def set_noise(network, vectors):
    """Gives TorchRL's layers the noise ε_in, ε_out of each layer."""
    for k, layer in enumerate(network[::2]):
        noise_in, noise_out = (v.double() for v in vectors[2 * k : 2 * k + 2])
        layer.weight_epsilon.copy_(noise_out.outer(noise_in))
        layer.bias_epsilon.copy_(noise_out)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("mode", ["draw", "mean"])
def test_outputs_and_gradients_are_those_of_torchrls_layers(noise, replicas, batch, mode):
    net = NoisyMLP(4, 3, (8, 6), replicas=replicas, dtype=torch.double)
    x = torch.randn(*replicas, *batch, 4, dtype=torch.double, requires_grad=True)
    out = net(x, mode)
    assert out.shape == (*replicas, *batch, 3)
    assert len(noise) == (6 if mode == "draw" else 0)
    count = net.replicas.numel()
    theirs = torchrl_networks(net)
    copy = x.detach().clone().requires_grad_()
    inputs = copy.reshape(count, *batch, 4)
    outs = []
    with set_exploration_type(RANDOM if mode == "draw" else ExplorationType.DETERMINISTIC):
        for k, network in enumerate(theirs):
            if mode == "draw":
                set_noise(network, [v.reshape(count, -1)[k] for v in noise])
            outs.append(network(inputs[k]))
    expected = torch.stack(outs).reshape(out.shape)
    torch.testing.assert_close(out, expected)
    leaves = [copy, *(p for n in theirs for p in n.parameters())]
    wanted = torch.autograd.grad(expected.square().sum(), leaves, materialize_grads=True)
    leaves = [x, *net.parameters()]
    gradients = torch.autograd.grad(out.square().sum(), leaves, materialize_grads=True)
    torch.testing.assert_close(gradients[0], wanted[0])
    per_network = [wanted[1 + k * 12 : 13 + k * 12] for k in range(count)]
    for ours, parts in zip(gradients[1:], zip(*per_network, strict=True), strict=True):
        torch.testing.assert_close(ours, torch.stack(parts).reshape(ours.shape))


@pytest.mark.parametrize("replicas", REPLICAS)
def test_rows_of_mode_local_are_networks_with_noise_of_their_own(noise, replicas):
    net = NoisyMLP(4, 3, (8, 6), replicas=replicas, dtype=torch.double)
    count, rows = net.replicas.numel(), 5
    x = torch.randn(*replicas, rows, 4, dtype=torch.double)
    out = net(x, "local").reshape(count, rows, 3)
    theirs, inputs = torchrl_networks(net), x.reshape(count, rows, 4)
    with set_exploration_type(RANDOM):
        for k, network in enumerate(theirs):
            for row in range(rows):
                set_noise(network, [v[k, :, row] for v in noise])
                torch.testing.assert_close(out[k, row], network(inputs[k, row]))


@pytest.mark.parametrize("replicas", REPLICAS)
def test_parameters_start_as_torchrls(replicas):
    net = NoisyMLP(9, 4, (25,), replicas=replicas, std_init=0.3)
    for layer in net.layers:
        theirs = NoisyLinear(layer.in_features, layer.out_features, std_init=0.3)
        assert dict(layer.named_parameters()).keys() == dict(theirs.named_parameters()).keys()
        for name, parameter in theirs.named_parameters():
            ours = getattr(layer, name).detach()
            assert ours.shape == (*replicas, *parameter.shape)
            if name.endswith("sigma"):
                assert torch.equal(ours, parameter.detach().expand(ours.shape))
            else:
                assert 0 < ours.abs().max() <= layer.in_features**-0.5
    means = net.layers[0].weight_mu.detach().reshape(-1, 25 * 9)
    assert torch.unique(means, dim=0).shape[0] == net.replicas.numel()
    assert NoisyMLP(9, 4).layers[0].std_init == NoisyLinear(9, 4).std_init
    with torch.no_grad():
        net.layers[1].bias_sigma.zero_()
    net.reset_parameters()
    torch.testing.assert_close(net.layers[1].bias_sigma, torch.full((*replicas, 4), 0.3 / 2))


def test_the_exploration_type_decides_where_nothing_else_does():
    net, x = NoisyMLP(4, 3, (8,)), torch.randn(6, 4)
    mean = net(x, "mean")
    assert torch.equal(net(x), mean)
    with set_exploration_type(RANDOM):
        assert not torch.equal(net(x), mean)
        with weight_scope("mean"):
            assert torch.equal(net(x), mean)


def test_the_layer_shows_its_means_and_has_no_noise_to_reset():
    layer = ReplicaNoisyLinear(4, 3, replicas=(2,))
    layer.apply(reset_noise)  # as TorchRL's trainers do
    with set_exploration_type(RANDOM):
        assert layer.weight is layer.weight_mu
        assert layer.bias is layer.bias_mu
    assert "in_features=4, out_features=3, bias=True, replicas=(2,), std_init=0.5" in repr(layer)


def test_what_does_not_fit_is_refused():
    net = NoisyMLP(4, 3, (8,), replicas=(2,))
    with pytest.raises(ValueError, match=r"input must have shape \[2, \*batch, 4\], got \[3, 4\]"):
        net(torch.ones(3, 4))
    with pytest.raises(ValueError, match="std_init must be positive and finite, got 0"):
        NoisyMLP(4, 3, std_init=0.0)
    with pytest.raises(ValueError, match="in_features and out_features must be positive, got 0"):
        ReplicaNoisyLinear(0, 3)


def test_states_hold_parameters_only():
    names = {
        f"layers.{k}.{n}_{p}" for k in "01" for n in ("weight", "bias") for p in ("mu", "sigma")
    }
    assert set(NoisyMLP(4, 3, (8,), replicas=(2,)).state_dict()) == names
