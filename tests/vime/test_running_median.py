"""The running median by which bonuses are divided."""

from __future__ import annotations

from statistics import median_low

import pytest
import torch

from bbq_torchrl.vime.running_median import RunningMedian


def test_the_running_median_is_that_of_the_last_medians():
    median = RunningMedian((2,), 3)
    seen = [[], []]
    for n in (3, 1, 4, 5, 2, 6):
        values, counts = torch.randn(2, n), torch.rand(2, n) < 0.7
        out = median.update(values, counts)
        for k in range(2):
            counted = values[k][counts[k]].tolist()
            if counted:
                seen[k].append(median_low(counted))
            if seen[k]:
                assert out[k] == pytest.approx(median_low(seen[k][-3:]))
            else:
                assert out[k].isnan()
