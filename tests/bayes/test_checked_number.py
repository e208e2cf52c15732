"""What a number of the parts may be: one for all replicas, or one for each."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.bayes.settings import checked_number


@pytest.mark.parametrize("value", [1e-50, 1, 1e39, 10**20, np.float64(0.5)])
def test_a_plain_number_stays_what_it_is_at_any_default_dtype(value):
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float16)
    try:
        assert checked_number("std", value) is value
    finally:
        torch.set_default_dtype(before)


@pytest.mark.parametrize("value", [0, -1e-50, math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("make", [float, torch.tensor, lambda v: [v, v], lambda v: np.full(2, v)])
def test_numbers_that_are_not_positive_and_finite_are_refused(value, make):
    with pytest.raises(ValueError, match="std must be positive and finite, got"):
        checked_number("std", make(value), (2,))


@pytest.mark.parametrize("value", [-1e-50, 1.000000001, math.nan])
@pytest.mark.parametrize("make", [float, lambda v: torch.tensor([v, 0.5], dtype=torch.float64)])
def test_both_ends_are_allowed_and_no_more(value, make):
    for end in (0.0, 1.0):
        checked_number("gamma", make(end), (2,), minimum=0, maximum=1)
    with pytest.raises(ValueError, match="gamma must be at least 0 and at most 1, got"):
        checked_number("gamma", make(value), (2,), minimum=0, maximum=1)


@pytest.mark.parametrize("make", [torch.tensor, list, np.array])
def test_values_are_one_for_each_replica(make):
    values = checked_number("std", make([0.25, 0.5]), (2,))
    assert values.dtype == torch.float64
    assert values.tolist() == [0.25, 0.5]
    for replicas in ((), (3,), (3, 2)):
        with pytest.raises(ValueError, match=r"std must be one number or have the replicas' shape"):
            checked_number("std", make([0.25, 0.5]), replicas)


def test_networks_are_built_on_the_meta_device():
    with torch.device("meta"):
        assert BayesMLP(4, 2, replicas=2)(torch.ones(2, 3, 4)).shape == (2, 3, 2)
