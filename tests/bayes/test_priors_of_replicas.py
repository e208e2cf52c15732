"""A prior and a start for each replica; tests/cli/test_values.py has how they train."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from bbq_torchrl.bayes import BayesMLP


def test_a_network_starts_each_element_where_it_is_told():
    stds = torch.tensor([0.01, 0.5])
    net = BayesMLP(3, 2, (4,), replicas=(2,), prior_std=stds)
    torch.testing.assert_close(net.posterior.sigma, stds[:, None].expand_as(net.posterior.rho))
    torch.testing.assert_close(net.posterior.prior_std, stds[:, None])
    started = BayesMLP(3, 2, (4,), replicas=(2,), std_init=stds)
    torch.testing.assert_close(started.posterior.sigma, net.posterior.sigma)
    assert started.posterior.prior_rho.shape == (1,)


@pytest.mark.parametrize("replicas", [3, (3,), np.int64(3), [np.int64(3)], torch.tensor(3)])
def test_any_integer_is_a_number_of_replicas(replicas):
    assert BayesMLP(3, 2, replicas=replicas).replicas == torch.Size([3])


@pytest.mark.parametrize("replicas", [0, -1, np.int64(0), (2, 0)])
def test_replicas_must_be_positive(replicas):
    with pytest.raises(ValueError, match="replicas must be positive, got"):
        BayesMLP(3, 2, replicas=replicas)


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
