"""Allowed settings: numbers, one for all replicas or one for each, and words."""

import math

import numpy as np
import pytest
import torch

from bbq_torchrl.bayes import BayesMLP, GaussianPosterior
from bbq_torchrl.bayes.replicas import checked_number
from bbq_torchrl.settings import PROBABILITY


@pytest.mark.parametrize("make", [torch.tensor, list, np.array])
def test_values_are_one_for_each_replica(make):
    values = checked_number("std", make([0.25, 0.5]), (2,))
    assert values.dtype == torch.float64
    assert values.tolist() == [0.25, 0.5]
    for replicas in ((), (3,), (3, 2)):
        with pytest.raises(ValueError, match=r"std must be one number or have the replicas' shape"):
            checked_number("std", make([0.25, 0.5]), replicas)


@pytest.mark.parametrize("value", [0, -1e-50, math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("make", [float, torch.tensor, lambda v: [0.5, v], lambda v: np.full(2, v)])
def test_numbers_that_are_not_positive_and_finite_are_refused(value, make):
    with pytest.raises(ValueError, match="std must be positive and finite, got"):
        checked_number("std", make(value), (2,))


@pytest.mark.parametrize("value", [-1e-50, 1.000000001, math.nan])
@pytest.mark.parametrize("make", [float, lambda v: torch.tensor([v, 0.5], dtype=torch.float64)])
def test_both_ends_are_allowed_and_no_more(value, make):
    for end in (0.0, 1.0):
        checked_number("gamma", make(end), (2,), PROBABILITY)
    with pytest.raises(ValueError, match="gamma must be a number between 0 and 1, got"):
        checked_number("gamma", make(value), (2,), PROBABILITY)


def test_a_network_starts_each_replica_at_its_std_init():
    stds = torch.tensor([0.01, 0.5])
    net = BayesMLP(3, 2, (4,), replicas=(2,), prior_std=stds, std_init=None)
    torch.testing.assert_close(net.posterior.sigma, stds[:, None].expand_as(net.posterior.rho))
    torch.testing.assert_close(net.posterior.prior_std, stds[:, None])
    started = BayesMLP(3, 2, (4,), replicas=(2,), std_init=stds)
    torch.testing.assert_close(started.posterior.sigma, net.posterior.sigma)
    assert started.posterior.prior_rho.shape == (1,)


@pytest.mark.parametrize("replicas", [3, (3,), np.int64(3), [np.int64(3)], torch.tensor(3)])
def test_any_integer_is_a_number_of_replicas(replicas):
    assert BayesMLP(3, 2, replicas=replicas).replicas == torch.Size([3])


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        ("prior_std", lambda: BayesMLP(3, 2, prior_std=-1.0)),
        ("prior_std", lambda: BayesMLP(3, 2, prior_std="fanin")),
        ("mean_init", lambda: BayesMLP(3, 2, mean_init=0.0)),
        ("prior_std", lambda: BayesMLP(3, 2, (), prior_std=torch.ones(3), replicas=2)),
        ("std_init", lambda: BayesMLP(3, 2, (), std_init=torch.ones(3), replicas=2)),
        ("prior_std", lambda: GaussianPosterior([3, 4, 5], [0.1, 0.2])),
        ("prior_std", lambda: GaussianPosterior([2, 2], [torch.ones(2)] * 2, replicas=2)),
        ("kl", lambda: GaussianPosterior([3], 1.0).sample_with_kl("mc")),
        ("local", lambda: GaussianPosterior([3], 1.0).weights("local")),
    ],
)
def test_what_is_no_network_is_refused(key, wrong):
    with pytest.raises(ValueError, match=key):
        wrong()
