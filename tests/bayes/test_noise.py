"""The noise of weight draws: fast normal numbers, a pool of them, and noise shared by passes."""

import pytest
import torch
from scipy import stats

from bbq_torchrl.bayes import BayesLinear, BayesMLP, weight_scope
from bbq_torchrl.bayes.noise import NoisePool, SharedNoise, fill_normal_

MANY = 2_000_000


def test_noise_is_normal():
    noise = fill_normal_(torch.empty(MANY))
    # P(statistic > 2.5 / √n) = 2 exp(-2 · 2.5²) = 7e-6
    assert stats.kstest(noise.numpy(), "norm").statistic < 2.5 * MANY**-0.5
    for power, expected, variance in ((1, 0, 1), (2, 1, 2), (4, 3, 96)):
        assert abs(noise.pow(power).mean() - expected) < 5 * (variance / MANY) ** 0.5
    beyond = 2 * stats.norm.sf(3)
    assert abs((noise.abs() > 3).float().mean() - beyond) < 5 * (beyond / MANY) ** 0.5


def test_numbers_are_independent_within_and_between_draws():
    draws = torch.stack([fill_normal_(torch.empty(MANY // 20)) for _ in range(20)])
    bound = 5 * (draws[0].numel()) ** -0.5
    off_diagonal = torch.corrcoef(draws) - torch.eye(20)
    assert off_diagonal.abs().max() < bound + 1e-6
    flat = draws.flatten()
    for lag in (1, 2, 3, 4, 5, 8, 256):
        assert abs((flat[lag:] * flat[:-lag]).mean()) < 5 * flat.numel() ** -0.5
        assert abs((flat[lag:].abs() * flat[:-lag].abs()).mean() - 2 / torch.pi) < 0.005


@pytest.mark.parametrize("count", [100, 2**13, 2**13 + 3])
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_torchs_generator_decides_the_numbers(count, dtype):
    out = torch.empty(count, dtype=dtype)
    first, state = fill_normal_(out).clone(), torch.get_rng_state()
    second = fill_normal_(out).clone()
    assert not (first == second).all()
    torch.set_rng_state(state)
    assert torch.equal(fill_normal_(out), second)


# ------------------------------------------------------------------------- a pool


def noise_of(net, draws, pool):
    """The noise of some draws, [draws, *replicas, P]: weights of a network with μ = 0, σ = 1."""
    net.posterior.reset_std_(1.0)
    with weight_scope(noise=pool), torch.no_grad():
        net.posterior.mu.zero_()
        return torch.stack([net.draw_weights() for _ in range(draws)])


def test_replicas_of_a_network_share_no_number_and_neither_do_layers():
    net, pool = BayesMLP(30, 20, (), replicas=(4,), dtype=torch.double), NoisePool()
    replicas = noise_of(net, 20, pool).unbind(1)
    layer = noise_of(BayesMLP(30, 20, (), dtype=torch.double), 20, pool)
    numbers = torch.cat([own.unique() for own in (*replicas, layer)])
    assert len(numbers.unique()) == len(numbers)


def test_a_pool_stays_and_comes_from_torchs_generator():
    net, pool = BayesMLP(30, 20, (), dtype=torch.double), NoisePool(2)

    torch.manual_seed(3)
    first = noise_of(net, 30, pool)
    assert len(first.unique()) <= 2 * first.shape[-1]
    torch.manual_seed(3)
    assert torch.equal(noise_of(net, 30, NoisePool(2)), first)
    with weight_scope(noise=pool), torch.no_grad():
        rows = net.draw_weights((50,))  # they have new noise
    assert len(rows.unique()) == rows.numel()


# ------------------------------------------------------------------------- shared by passes


@pytest.mark.parametrize("source", [None, NoisePool()], ids=["new", "pool"])
@pytest.mark.parametrize("kl", ["closed", "sampled", None])
def test_other_parameters_get_the_same_noise(kl, source):
    # large enough for replicas that are drawn a part at a time
    net = BayesMLP(150, 40, (150, 150), replicas=(5,), dtype=torch.double)
    posterior, noise = net.posterior, SharedNoise(source)
    with weight_scope("draw", noise=noise, kl=kl), torch.no_grad():
        epsilon = (posterior.weights() - posterior.mu) / posterior.sigma
    assert epsilon.std() == pytest.approx(1, abs=5 * (2 * epsilon.numel()) ** -0.5)
    with weight_scope("draw", noise=noise.again()), torch.no_grad():
        for parameter in posterior.parameters():
            parameter.sub_(0.5)
        second = posterior.weights()
    torch.testing.assert_close(second, posterior.mu + posterior.sigma * epsilon)


def test_a_layer_that_draws_twice_shares_draw_by_draw():
    layer, x = BayesLinear(4, 4, prior_std=0.5), torch.randn(5, 4)
    noise = SharedNoise()

    def outputs(calls):
        with weight_scope("draw", noise=noise.again()):
            return [layer(x) for _ in range(calls)]

    first, second, third = outputs(2), outputs(3), outputs(3)
    assert not torch.equal(*first)
    assert all(map(torch.equal, first, second[:2]))
    assert all(map(torch.equal, second, third))  # the one more is shared from then on
    with (
        weight_scope(noise=noise.again()),
        pytest.raises(ValueError, match=r"draw of shape \[3, 20\] cannot share noise of shape"),
    ):
        layer.draw_weights((3,))
