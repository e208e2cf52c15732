"""Noise out of a pool: independent normal numbers in each draw, none that two networks share."""

from __future__ import annotations

import pytest
import torch
from scipy import stats

from bbq_torchrl.bayes import BayesMLP, weight_scope
from bbq_torchrl.bayes.noise_sources import NoisePool, SharedNoise

# A test of chance fails by chance with this probability.
RARE = 1e-6


def noise_of(net: BayesMLP, draws: int, pool: NoisePool) -> torch.Tensor:
    """The noise of some draws, [draws, *replicas, P]: weights of a network with μ = 0, σ = 1."""
    net.posterior.reset_std_(1.0)
    with weight_scope(noise=pool), torch.no_grad():
        return torch.stack([net.draw_weights() for _ in range(draws)])


@pytest.mark.parametrize("replicas", [(), (3,), (2, 2)], ids=str)
def test_a_draw_is_of_standard_normal_numbers(replicas):
    noise = noise_of(BayesMLP(60, 40, (50,), replicas=replicas), 1, NoisePool())

    assert noise.shape == (1, *replicas, 61 * 50 + 51 * 40)
    assert stats.kstest(noise.flatten().double().numpy(), "norm").pvalue > RARE
    rows = noise.reshape(-1, noise.shape[-1]).double()
    neighbors = (rows[:, 1:] * rows[:, :-1]).sum() / rows[:, 1:].numel() ** 0.5
    assert abs(float(neighbors)) < 5


def test_one_weight_has_normal_noise_from_draw_to_draw():
    net, pool = BayesMLP(60, 40, (50,)), NoisePool(64)

    noise = noise_of(net, 400, pool)[:, ::997]

    # Windows lie where chance has it, and hardly ever in the same place twice.
    assert stats.kstest(noise.flatten().double().numpy(), "norm").pvalue > RARE
    assert len(noise[:, 0].unique()) > 390


def test_replicas_of_a_network_share_no_number_and_neither_do_layers():
    net = BayesMLP(30, 20, (), replicas=(4,), dtype=torch.double)
    pool = NoisePool()
    own = [noise_of(net, 20, pool)[:, r].unique().tolist() for r in range(4)]
    own.append(noise_of(BayesMLP(30, 20, (), dtype=torch.double), 20, pool).unique().tolist())

    everything = [number for numbers in own for number in numbers]
    assert len(everything) == len(set(everything))


def test_the_pool_stays_until_it_is_cleared_and_comes_from_torchs_generator():
    net, pool = BayesMLP(30, 20, (), dtype=torch.double), NoisePool(2)

    torch.manual_seed(3)
    first = noise_of(net, 30, pool)
    assert len(first.unique()) <= 2 * first.shape[-1]
    pool.clear()
    second = noise_of(net, 30, pool)
    assert not set(first.unique().tolist()) & set(second.unique().tolist())
    pool.clear()
    torch.manual_seed(3)
    assert torch.equal(noise_of(net, 30, pool), first)


def test_draws_for_rows_are_not_concerned():
    net, pool = BayesMLP(30, 20, (), dtype=torch.double), NoisePool(2)
    with weight_scope(noise=pool), torch.no_grad():
        rows = net.draw_weights((50,))
    assert len(rows.unique()) == rows.numel()


def test_shared_noise_shares_what_comes_from_a_pool():
    net, pool = BayesMLP(30, 2, dtype=torch.double), NoisePool()
    noise = SharedNoise(pool)
    with weight_scope(noise=noise):
        first = net.draw_weights()
    with weight_scope(noise=noise.again()):
        second = net.draw_weights()
    with weight_scope(noise=pool):
        third = net.draw_weights()
    assert torch.equal(first, second)
    assert not torch.equal(first, third)


def test_a_pool_of_one_draw_is_refused():
    with pytest.raises(ValueError, match="draws must be at least 2, got 1"):
        NoisePool(1)
