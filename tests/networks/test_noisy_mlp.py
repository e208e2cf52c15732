"""NoisyMLP: outputs, replicas and modes by their definition, its start against TorchRL's."""

import pytest
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import NoisyLinear, reset_noise

from bbq_torchrl.networks import NoisyMLP, ReplicaNoisyLinear

REPLICAS = [(), (1,), (3,), (2, 3)]


@pytest.fixture
def noise(monkeypatch):
    """The noise vectors of calls, in order: ε_in and ε_out of each layer."""
    drawn, scale = [], NoisyLinear._scale_noise

    def record(self, size):
        drawn.append(scale(self, size))
        return drawn[-1]

    monkeypatch.setattr(ReplicaNoisyLinear, "_scale_noise", record)
    return drawn


def by_definition(net, x, noise):
    """Outputs with a separate weight matrix μ + σ ∘ (ε_out ⊗ ε_in) for each row."""
    count = net.replicas.numel()
    out = x.reshape(count, -1, x.shape[-1])
    for k, layer in enumerate(net.layers):
        sizes = layer.in_features, layer.out_features
        ones = torch.zeros(count, sizes[0], 1), torch.zeros(count, sizes[1], 1)
        vectors = noise[2 * k : 2 * k + 2] or ones
        # [replicas, rows, size]; one for all rows if they share their noise
        noise_in, noise_out = (
            vector.double().reshape(count, size, -1).mT
            for vector, size in zip(vectors, sizes, strict=True)
        )
        weight, weight_sigma, bias, bias_sigma = (
            parameter.reshape(count, 1, sizes[1], -1)
            for parameter in (layer.weight_mu, layer.weight_sigma, layer.bias_mu, layer.bias_sigma)
        )
        weight = weight + weight_sigma * noise_out.unsqueeze(-1) * noise_in.unsqueeze(-2)
        bias = bias + bias_sigma * noise_out.unsqueeze(-1)
        out = (weight @ (out.relu() if k else out).unsqueeze(-1) + bias).squeeze(-1)
    return out.reshape(*x.shape[:-1], -1)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("batch", [(), (6,), (2, 4)])
@pytest.mark.parametrize("mode", ["draw", "local", "mean"])
def test_outputs_and_gradients_are_those_of_the_noise_that_is_drawn(noise, replicas, batch, mode):
    net = NoisyMLP(4, 3, (8, 6), replicas=replicas, dtype=torch.double)
    x = torch.randn(*replicas, *batch, 4, dtype=torch.double, requires_grad=True)
    out = net(x, mode)
    expected = by_definition(net, x, noise)
    torch.testing.assert_close(out, expected)
    rows = torch.Size(batch).numel() if mode == "local" else 1
    sizes = [0] if mode == "mean" else [4, 8, 8, 6, 6, 3]
    counts = [vector.numel() for vector in noise]
    assert counts == [net.replicas.numel() * rows * size for size in sizes if size]
    wanted, probe = [x, *net.parameters()], torch.randn_like(out)
    ours, theirs = (
        torch.autograd.grad(outs, wanted, probe, materialize_grads=True) for outs in (out, expected)
    )
    torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("replicas", REPLICAS)
def test_parameters_start_as_torchrls(replicas):
    net = NoisyMLP(9, 4, (25,), replicas=replicas, std_init=0.3)
    with torch.no_grad():
        net.layers[1].bias_sigma.zero_()
    net.reset_parameters()
    for layer in net.layers:
        theirs = NoisyLinear(layer.in_features, layer.out_features, std_init=0.3)
        assert layer.state_dict().keys() == dict(theirs.named_parameters()).keys()
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


def test_the_layer_shows_its_means_and_has_no_noise_to_reset():
    layer = ReplicaNoisyLinear(4, 3, replicas=(2,))
    layer.apply(reset_noise)  # as TorchRL's trainers do
    with set_exploration_type(ExplorationType.RANDOM):
        assert layer.weight is layer.weight_mu
        assert layer.bias is layer.bias_mu
