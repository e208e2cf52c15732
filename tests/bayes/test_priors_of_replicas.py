"""A prior and a start for each replica: as networks that have them alone."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.bayes import BayesMLP, GaussianPosterior
from bbq_torchrl.networks.growth import reset_inactive_


@pytest.mark.parametrize("kind", ["closed", "sampled"])
def test_each_element_is_bitwise_as_where_all_have_its_prior(kind):
    replicas, weights = (5,), (40_001,)  # more than are worked on at a time
    std = torch.tensor([0.05, 0.1, 0.2, 0.4, 0.8])

    def outcome(prior_std):
        torch.manual_seed(0)
        posterior = GaussianPosterior(weights, prior_std, replicas=replicas)
        start = posterior.rho.detach().clone()
        with torch.no_grad():
            posterior.mu.normal_(0, 0.1)
            posterior.rho.uniform_(-4, 1)
        drawn, kl = posterior.sample_with_kl(kind)
        gradients = torch.autograd.grad(drawn.square().sum() + kl.sum(), posterior.parameters())
        return start, drawn, kl, posterior.kl(), *gradients

    together = outcome(std)
    for element in range(5):
        # The number that float32 holds: a tensor of 0.05 is not the Python number 0.05.
        alone = outcome(float(std[element]))
        for one, other in zip(together, alone, strict=True):
            assert torch.equal(one[element], other[element])


def test_a_network_starts_each_element_where_it_is_told():
    stds = torch.tensor([0.01, 0.5])
    net = BayesMLP(3, 2, (4,), replicas=(2,), prior_std=stds)
    torch.testing.assert_close(net.posterior.sigma, stds[:, None].expand_as(net.posterior.rho))
    torch.testing.assert_close(net.posterior.prior_std, stds[:, None])
    started = BayesMLP(3, 2, (4,), replicas=(2,), std_init=stds)
    torch.testing.assert_close(started.posterior.sigma, net.posterior.sigma)
    assert started.posterior.prior_rho.shape == (1,)


def test_what_is_inactive_is_at_its_own_elements_prior():
    stds = torch.tensor([0.01, 0.5])
    net = BayesMLP(3, 2, (4,), replicas=(2,), prior_std=stds, std_init=2.0)
    inactive = torch.tensor([False, False, True])
    reset_inactive_(net, inputs=inactive)
    matrix, _ = net.layout.unflatten(net.posterior.sigma)[0]
    torch.testing.assert_close(matrix[:, 2], stds[:, None].expand(2, 4))
    torch.testing.assert_close(matrix[:, 0], torch.full((2, 4), 2.0))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (torch.ones(3), r"must be one number or have the replicas' shape \[2\], got \[3\]"),
        (torch.tensor([0.1, -1.0]), r"must be positive and finite, got \[0\.1.*, -1\.0\]"),
        (torch.tensor([0.1, torch.inf]), "must be positive and finite"),
    ],
)
def test_what_does_not_fit_the_replicas_is_refused(values, message):
    with pytest.raises(ValueError, match=f"prior_std {message}"):
        BayesMLP(3, 2, replicas=(2,), prior_std=values)
    with pytest.raises(ValueError, match=f"std_init {message}"):
        BayesMLP(3, 2, replicas=(2,), std_init=values)
