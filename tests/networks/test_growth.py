"""A masked network of full size is the same as one that grows: until then, a smaller one."""

from functools import partial

import pytest
import torch
from q_transitions import FixedNoise
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.bayes import BayesMLP, kl_divergence, weight_scope
from bbq_torchrl.networks import BootstrapMLP, FlatMLP, NoisyMLP

REPLICAS = [(), (2,)]
INPUTS, OUTPUTS = torch.tensor([4, 0, 2]), torch.tensor([1, 3])  # the active ones, in their order
LATE_INPUTS = torch.tensor([False, True, False, True, False])
LATE_OUTPUTS = torch.tensor([True, False, True, False])


def places_of_active_weights(layout):
    """Indices of the weights of the active features and actions, int64 [P_small]."""
    layers = layout.unflatten(torch.arange(layout.numel))
    (first, bias), *between, (last, last_bias) = layers
    parts = [first[INPUTS], bias, *(part for layer in between for part in layer)]
    parts += [last[:, OUTPUTS], last_bias[OUTPUTS]]
    return torch.cat([part.flatten() for part in parts])


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("kind", [FlatMLP, BayesMLP])
def test_a_masked_network_trains_as_a_smaller_one(kind, replicas):
    """The proof: both see the same data, and what is inactive stays where growth would put it."""
    options = {"replicas": replicas, "dtype": torch.double}
    if kind is BayesMLP:
        options.update(prior_std=0.3, mean_init="kaiming", std_init=0.05)
    masked, small = kind(5, 4, (7, 6), **options), kind(3, 2, (7, 6), **options)
    with torch.no_grad():
        masked.reset_inactive_(LATE_INPUTS, LATE_OUTPUTS)
    start = [parameter.detach().clone() for parameter in masked.parameters()]
    index = places_of_active_weights(masked.layout)
    with torch.no_grad():
        for ours, theirs in zip(small.parameters(), masked.parameters(), strict=True):
            ours.copy_(theirs[..., index])

    def step(network, optimizer, noise, x, action, y):
        with weight_scope("draw", noise=FixedNoise(noise), kl="closed") as scope:
            chosen = network(x).gather(-1, action.unsqueeze(-1)).squeeze(-1)
        kl = scope.kl.total().sum() if kind is BayesMLP else 0
        optimizer.zero_grad()
        ((chosen - y).square().sum() + 0.01 * kl).backward()
        optimizer.step()

    optimizers = [torch.optim.Adam(network.parameters(), 1e-2) for network in (small, masked)]
    for _ in range(40):
        # the same noise for the same weight, however large the network is
        noise = torch.randn(*replicas, masked.layout.numel, dtype=torch.double)
        y, action = torch.randn(*replicas, 9).double(), torch.randint(2, (*replicas, 9))
        x = torch.randn(*replicas, 9, 5).double().masked_fill(LATE_INPUTS, 0.0)
        step(small, optimizers[0], noise[..., index], x[..., INPUTS], action, y)
        step(masked, optimizers[1], noise, x, OUTPUTS[action], y)

    is_late = torch.ones(masked.layout.numel, dtype=torch.bool)
    is_late[index] = False
    for ours, theirs, then in zip(small.parameters(), masked.parameters(), start, strict=True):
        torch.testing.assert_close(ours, theirs[..., index], rtol=1e-9, atol=1e-10)
        assert torch.equal(theirs[..., is_late], then[..., is_late])
        assert (theirs[..., index] != then[..., index]).any()
    if kind is BayesMLP:
        torch.testing.assert_close(kl_divergence(masked), kl_divergence(small))


LATE = {
    "noisy": NoisyMLP,
    "trunk": BootstrapMLP,
    "short trunk, prior": partial(BootstrapMLP, trunk_layers=1, prior_scale=1.0),
    "no trunk": partial(BootstrapMLP, trunk_layers=0),
    "no trunk, prior": partial(BootstrapMLP, trunk_layers=0, prior_scale=1.0),
}


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("kind", LATE)
def test_a_feature_that_appears_late_changes_nothing_before_it_is_learned(kind, replicas):
    # wide enough that no layer is dead in all rows
    net = LATE[kind](5, 4, (32, 32), replicas=replicas)
    x = torch.randn(*replicas, 8, 5)
    early = x.masked_fill(LATE_INPUTS, 0)

    def values(x):
        torch.manual_seed(0)  # one noise for all
        with set_exploration_type(ExplorationType.RANDOM):
            return net(x)

    def learn(x):
        optimizer.zero_grad()
        values(x).square().sum().backward()
        optimizer.step()

    optimizer = torch.optim.Adam(net.parameters(), 0.01)
    start = values(early)
    with torch.no_grad():
        net.reset_inactive_(LATE_INPUTS, LATE_OUTPUTS)
    assert torch.equal(values(early), start)  # new outputs keep their start
    assert torch.equal(values(x), start)
    for _ in range(5):
        learn(early)
    assert not torch.equal(values(early), start)
    assert torch.equal(values(x), values(early))
    learn(x)
    assert not torch.equal(values(x), values(early))
