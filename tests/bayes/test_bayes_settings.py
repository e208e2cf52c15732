"""Allowed settings: numbers, one for all replicas or one for each, and words.

tests/cli/test_values.py has how replicas with values of their own train.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from bbq_torchrl.bayes import BayesConv2d, BayesGRU, BayesMLP, GaussianPosterior
from bbq_torchrl.bayes.replicas import checked_number
from bbq_torchrl.settings import PROBABILITY


@pytest.mark.parametrize("value", [1e-50, 1, 1e39, 10**20, np.float64(0.5)])
def test_a_plain_number_stays_what_it_is_at_any_default_dtype(value):
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float16)
    try:
        assert checked_number("std", value) is value
    finally:
        torch.set_default_dtype(before)


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


OF_TWO = {"replicas": 2, "hidden": ()}
PRIOR = GaussianPosterior([3], 1.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: BayesMLP(3, 2, replicas=0), "replicas must be positive, got 0"),
        (lambda: BayesMLP(3, 2, replicas=(2, 0)), "replicas must be positive, got"),
        (lambda: BayesMLP(3, 2, prior_std=-1.0), "prior_std must be positive or 'fan_in', got -1"),
        (lambda: BayesMLP(3, 2, prior_std="fanin"), "prior_std must be positive or 'fan_in', got"),
        (lambda: BayesMLP(3, 2, mean_init=0.0), r"mean_init must be one of zero, kaiming"),
        (
            lambda: BayesMLP(3, 2, prior_std=torch.ones(3), **OF_TWO),
            r"prior_std must be one number or have the replicas' shape \[2\], got \[3\]",
        ),
        (
            lambda: BayesMLP(3, 2, std_init=torch.ones(3), **OF_TWO),
            r"std_init must be one number or have the replicas' shape \[2\], got \[3\]",
        ),
        (
            lambda: BayesMLP(3, 2, prior_std=torch.tensor([0.1, -1.0]), **OF_TWO),
            r"prior_std must be positive and finite, got \[0\.1.*, -1\.0\]",
        ),
        (lambda: GaussianPosterior([3], 0.0), "prior_std must be positive and finite, got 0"),
        (lambda: GaussianPosterior([3], math.inf), "prior_std must be positive and finite, got"),
        (lambda: PRIOR.reset_std_(math.nan), "std_init must be positive and finite, got nan"),
        (lambda: GaussianPosterior([3, 4, 5], [0.1, 0.2]), "one for each of the 3 groups, got 2"),
        (
            lambda: GaussianPosterior([2, 2], [torch.ones(2), torch.ones(2)], replicas=2),
            r"prior_std must be one number .*, got \[2\]",
        ),
        (
            lambda: PRIOR.sample_with_kl("mc"),
            r"kl must be one of closed, sampled, got 'mc'",
        ),
        (
            lambda: PRIOR.sample_with_kl("sampled", torch.ones(())),
            "known_kl needs kl='closed', got",
        ),
        (lambda: BayesConv2d(2, 0, 3), "kernel_size must be positive, got 2, 0 and 3"),
        (lambda: PRIOR.weights("local"), 'mode "local" needs a layer with local'),
        (lambda: BayesGRU(0, 3), "input_size and hidden_size must be positive, got 0 and 3"),
    ],
)
def test_what_is_no_network_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()
