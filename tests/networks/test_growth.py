"""Growing a network, and starting a masked one of full size, are the same thing."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.bayes import BayesMLP, GaussianPosterior, kl_divergence
from bbq_torchrl.bayes.functional import FlatLayout
from bbq_torchrl.networks import BootstrapMLP, FlatMLP, NoisyMLP, grow
from bbq_torchrl.networks.growth import grow_flat, growth_index, reset_inactive_

REPLICAS = [(), (2,)]
INPUTS, OUTPUTS = torch.tensor([4, 0, 2]), torch.tensor([1, 3])  # where old ones go


def wide(x):
    """Old features [*, 3] among five, the others 0."""
    out = x.new_zeros(*x.shape[:-1], 5)
    out[..., INPUTS] = x
    return out


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("kind", [FlatMLP, BayesMLP])
def test_a_grown_network_gives_the_old_outputs_where_new_inputs_are_zero(kind, replicas):
    net = kind(3, 2, (8, 8), replicas=replicas)
    if kind is BayesMLP:
        with torch.no_grad():
            net.posterior.mu.normal_()
    grown = grow(net, 5, 4, inputs=INPUTS, outputs=OUTPUTS)
    x = torch.randn(*replicas, 6, 3)
    torch.testing.assert_close(grown(wide(x), "mean")[..., OUTPUTS], net(x, "mean"))
    assert (net.in_features, net.out_features) == (3, 2)
    assert (grown.in_features, grown.out_features) == (5, 4)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("prior_std", [0.3, "fan_in"])
def test_new_weights_add_no_kl(replicas, prior_std):
    net = BayesMLP(3, 2, (8,), replicas=replicas, prior_std=prior_std, dtype=torch.double)
    with torch.no_grad():
        net.posterior.mu.normal_()
        net.posterior.rho.uniform_(-3, 0)
    grown = grow(net, 5, 4, inputs=INPUTS, outputs=OUTPUTS)
    kl = kl_divergence(grown)
    torch.testing.assert_close(kl, kl_divergence(net))
    kl.sum().backward()
    is_new = torch.ones(grown.layout.numel, dtype=torch.bool)
    is_new[growth_index(net.layout, grown.layout, INPUTS, OUTPUTS)] = False
    for parameter in grown.parameters():
        assert not parameter.grad[..., is_new].any()
        assert parameter.grad[..., ~is_new].all()


def test_new_input_weights_of_a_plain_network_start_at_zero():
    grown = grow(FlatMLP(3, 2, (8,), replicas=(2,)), 5, 4, inputs=INPUTS, outputs=OUTPUTS)
    (first, _), (last, bias) = grown.layout.unflatten(grown.weight)
    assert not first[:, [1, 3]].any()
    assert first[:, INPUTS].all()
    assert last.all()  # new outputs start like nn.Linear's
    assert bias.all()


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("kind", [FlatMLP, BayesMLP])
def test_growing_equals_masking_through_training(kind, replicas, monkeypatch):
    """The proof: both ways see the same data, a feature and an action appear half-way."""
    options = {"replicas": replicas, "dtype": torch.double}
    if kind is BayesMLP:
        options.update(prior_std=0.3, mean_init="kaiming", std_init=0.05)
    masked = kind(5, 4, (7, 6), **options)
    late_inputs = torch.ones(5, dtype=torch.bool)
    late_inputs[INPUTS] = False
    late_outputs = torch.ones(4, dtype=torch.bool)
    late_outputs[OUTPUTS] = False
    reset_inactive_(masked, inputs=late_inputs, outputs=late_outputs)
    start = {k: v.clone() for k, v in masked.state_dict().items()}
    small = kind(3, 2, (7, 6), **options)
    index = growth_index(small.layout, masked.layout, INPUTS, OUTPUTS)
    with torch.no_grad():
        for ours, theirs in zip(small.parameters(), masked.parameters(), strict=True):
            ours.copy_(theirs[..., index])

    noise = {}

    def fill(self, buffer):
        # the same noise for the same weight, however large the network is
        wanted = noise["full"].reshape(-1, masked.layout.numel)
        wanted = wanted[:, index] if buffer.shape[-1] == small.layout.numel else wanted
        rows = buffer.view(-1, buffer.shape[-1])
        rows.copy_(wanted[noise["row"] : noise["row"] + rows.shape[0]])
        noise["row"] += rows.shape[0]

    monkeypatch.setattr(GaussianPosterior, "fill_noise_", fill)

    def optimizer_of(network):
        return torch.optim.Adam(network.parameters(), 1e-2)

    def step(network, optimizer, x, action, y):
        noise["row"] = 0
        if kind is BayesMLP:
            weights, kl = network.posterior.sample_with_kl()
            out = network(x, weights=weights)
        else:
            out, kl = network(x), torch.zeros(())
        chosen = out.gather(-1, action.unsqueeze(-1)).squeeze(-1)
        optimizer.zero_grad()
        ((chosen - y).square().sum() + 0.01 * kl.sum()).backward()
        optimizer.step()

    def data():
        noise["full"] = torch.randn(*replicas, masked.layout.numel, dtype=torch.double)
        y = torch.randn(*replicas, 9, dtype=torch.double)
        return torch.randn(*replicas, 9, 5, dtype=torch.double), y

    small_optimizer, masked_optimizer = optimizer_of(small), optimizer_of(masked)
    for _ in range(40):
        x, y = data()
        action = torch.randint(2, (*replicas, 9))
        step(small, small_optimizer, x[..., INPUTS], action, y)
        step(masked, masked_optimizer, wide(x[..., INPUTS]), OUTPUTS[action], y)

    # until the feature appears its weights are bitwise untouched
    is_new = torch.ones(masked.layout.numel, dtype=torch.bool)
    is_new[index] = False
    if kind is BayesMLP:
        for name in ("mu", "rho"):
            now = getattr(masked.posterior, name).detach()
            assert torch.equal(now[..., is_new], start[f"posterior.{name}"][..., is_new])
    else:
        assert torch.equal(masked.weight[..., is_new], start["weight"][..., is_new])

    grown = grow(small, 5, 4, inputs=INPUTS, outputs=OUTPUTS)
    grown_optimizer = optimizer_of(grown)
    for old, new in zip(small.parameters(), grown.parameters(), strict=True):
        state = small_optimizer.state[old]
        grown_optimizer.state[new] = {
            "step": state["step"].clone(),
            "exp_avg": grow_flat(state["exp_avg"], torch.zeros_like(new), index),
            "exp_avg_sq": grow_flat(state["exp_avg_sq"], torch.zeros_like(new), index),
        }
    if kind is FlatMLP:  # new outputs start at random in both
        with torch.no_grad():
            grown.weight[..., is_new] = masked.weight[..., is_new]
    for _ in range(40):
        x, y = data()
        action = torch.randint(4, (*replicas, 9))
        step(grown, grown_optimizer, x, action, y)
        step(masked, masked_optimizer, x, action, y)
    for ours, theirs in zip(grown.parameters(), masked.parameters(), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-10)


def test_inactive_weights_of_a_masked_network_start_where_growth_puts_them():
    inputs = torch.tensor([False, True, False])
    outputs = torch.tensor([True, False])
    net = BayesMLP(3, 2, (4,), replicas=(2,), prior_std=0.3, mean_init="kaiming", std_init=0.01)
    reset_inactive_(net, inputs=inputs, outputs=outputs)
    prior = net.posterior.prior_rho.item()
    for name, inactive in (("mu", 0.0), ("rho", prior)):
        (first, bias), (last, last_bias) = net.layout.unflatten(getattr(net.posterior, name))
        assert (first[:, inputs] == inactive).all()
        assert (last[..., outputs] == inactive).all()
        assert (last_bias[..., outputs] == inactive).all()
        assert (first[:, ~inputs] != inactive).all()
        assert (last[..., ~outputs] != inactive).all()
        assert (bias != inactive).all()
    plain = FlatMLP(3, 2, (4,))
    reset_inactive_(plain, inputs=inputs, outputs=outputs)
    (first, _), (last, _) = plain.layout.unflatten(plain.weight)
    assert not first[inputs].any()
    assert first[~inputs].all()
    assert last.all()


def test_growth_that_does_not_fit_is_refused():
    net = FlatMLP(3, 2, (8,))
    with pytest.raises(ValueError, match="inputs must not shrink: from 3 to 2"):
        grow(net, 2, 2)
    for bad in ([0, 0, 1], [0, 1, 5], [-1, 0, 1], [0, 1]):
        with pytest.raises(ValueError, match="inputs must be 3 different places below 5, got"):
            grow(net, 5, 2, inputs=torch.tensor(bad))
    with pytest.raises(ValueError, match=r"hidden sizes must stay \(8,\), got \(9,\)"):
        growth_index(net.layout, FlatLayout((3, 9, 2)))
    with pytest.raises(ValueError, match="must be a BayesMLP or FlatMLP to grow, got a Noisy"):
        grow(NoisyMLP(3, 2), 4, 2)


@pytest.mark.parametrize("kind", [FlatMLP, BayesMLP, NoisyMLP, BootstrapMLP])
def test_a_mask_that_does_not_fit_is_refused(kind):
    with pytest.raises(ValueError, match=r"inputs must be a bool mask of shape \[3\], got"):
        reset_inactive_(kind(3, 2), inputs=torch.tensor([0, 1, 1]))
    with pytest.raises(ValueError, match=r"outputs must be a bool mask of shape \[2\], got"):
        reset_inactive_(kind(3, 2), outputs=torch.ones(3, dtype=torch.bool))


@pytest.mark.parametrize("replicas", REPLICAS)
def test_a_feature_that_appears_in_a_noisy_network_changes_nothing_before_it_is_learned(replicas):
    net = NoisyMLP(5, 4, (8,), replicas=replicas)
    inputs = torch.tensor([False, True, False, True, False])
    outputs = torch.tensor([False, False, True, False])
    start = {k: v.clone() for k, v in net.state_dict().items()}
    reset_inactive_(net, inputs=inputs, outputs=outputs)
    for name, value in net.state_dict().items():
        if name in ("layers.0.weight_mu", "layers.0.weight_sigma"):
            assert not value[..., inputs].any()
            assert torch.equal(value[..., ~inputs], start[name][..., ~inputs])
        else:  # new outputs keep their start
            assert torch.equal(value, start[name])
    x = torch.randn(*replicas, 6, 5)
    for mode in ("mean", "draw", "local"):
        outs = []
        for seen in (x, x.masked_fill(inputs, 0.0)):
            torch.manual_seed(0)
            outs.append(net(seen, mode))
        torch.testing.assert_close(*outs)
