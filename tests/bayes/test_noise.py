"""Fast normal noise: its distribution, independence and reproducibility."""

from __future__ import annotations

import pytest
import torch
from scipy import stats

from bbq_torchrl.bayes.noise import fill_normal_

MANY = 2_000_000


def test_noise_is_normal():
    noise = fill_normal_(torch.empty(MANY))
    # P(statistic > 2.5 / √n) = 2 exp(-2 · 2.5²) = 7e-6
    assert stats.kstest(noise.numpy(), "norm").statistic < 2.5 * MANY**-0.5
    assert abs(noise.mean()) < 5 * MANY**-0.5
    assert abs(noise.var() - 1) < 5 * (2 / MANY) ** 0.5
    assert abs(noise.pow(4).mean() - 3) < 5 * (96 / MANY) ** 0.5
    beyond = (noise.abs() > 3).float().mean()
    expected = 2 * stats.norm.sf(3)
    assert abs(beyond - expected) < 5 * (expected / MANY) ** 0.5


def test_numbers_are_independent_within_and_between_draws():
    draws = torch.stack([fill_normal_(torch.empty(MANY // 20)) for _ in range(20)])
    bound = 5 * (draws[0].numel()) ** -0.5
    off_diagonal = torch.corrcoef(draws) - torch.eye(20)
    assert off_diagonal.abs().max() < bound + 1e-6
    flat = draws.flatten()
    for lag in (1, 2, 3, 4, 5, 8, 256):
        assert abs((flat[lag:] * flat[:-lag]).mean()) < 5 * flat.numel() ** -0.5
        assert abs((flat[lag:].abs() * flat[:-lag].abs()).mean() - 2 / torch.pi) < 0.005


@pytest.mark.parametrize("count", [1, 100, 2**13, 2**13 + 1, 2**13 + 2, 2**13 + 3])
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_torchs_generator_decides_the_numbers(count, dtype):
    torch.manual_seed(1)
    first, second = (fill_normal_(torch.empty(count, dtype=dtype)) for _ in range(2))
    torch.manual_seed(1)
    assert torch.equal(fill_normal_(torch.empty(count, dtype=dtype)), first)
    state = torch.get_rng_state()
    assert torch.equal(fill_normal_(torch.empty(count, dtype=dtype)), second)
    torch.set_rng_state(state)
    assert torch.equal(fill_normal_(torch.empty(count, dtype=dtype)), second)
    assert not (first == second).all()


def test_any_shape_is_filled_in_place():
    for shape in [(3, 5), (2, 100, 100), (0,), ()]:
        out = torch.full(shape, 99.0)
        assert fill_normal_(out) is out
        assert not (out == 99).any()
    columns = torch.full((200, 200), 99.0)[:, :100]
    fill_normal_(columns)  # not contiguous
    assert not (columns == 99).any()
