"""The noise of weight draws: fast normal numbers, a pool of them, and noise shared by passes."""

from __future__ import annotations

import pytest
import torch
from scipy import stats
from torch import nn
from torch.func import functional_call

from bbq_torchrl.bayes import BayesLinear, BayesMLP, weight_scope
from bbq_torchrl.bayes.noise import NoisePool, SharedNoise, fill_normal_

MANY = 2_000_000
# A test of chance fails by chance with this probability.
RARE = 1e-6


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


@pytest.mark.parametrize("count", [100, 2**13, 2**13 + 3])
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_torchs_generator_decides_the_numbers(count, dtype):
    torch.manual_seed(1)
    first = fill_normal_(torch.empty(count, dtype=dtype))
    state = torch.get_rng_state()
    second = fill_normal_(torch.empty(count, dtype=dtype))
    assert not (first == second).all()
    torch.manual_seed(1)
    assert torch.equal(fill_normal_(torch.empty(count, dtype=dtype)), first)
    torch.set_rng_state(state)
    assert torch.equal(fill_normal_(torch.empty(count, dtype=dtype)), second)


def test_any_shape_is_filled_in_place():
    for shape in [(3, 5), (2, 100, 100), (0,), ()]:
        out = torch.full(shape, 99.0)
        assert fill_normal_(out) is out
        assert not (out == 99).any()
    columns = torch.full((200, 200), 99.0)[:, :100]
    fill_normal_(columns)  # not contiguous
    assert not (columns == 99).any()


# ------------------------------------------------------------------------- a pool


def noise_of(net: BayesMLP, draws: int, pool: NoisePool) -> torch.Tensor:
    """The noise of some draws, [draws, *replicas, P]: weights of a network with μ = 0, σ = 1."""
    net.posterior.reset_std_(1.0)
    with weight_scope(noise=pool), torch.no_grad():
        return torch.stack([net.draw_weights() for _ in range(draws)])


@pytest.mark.parametrize("replicas", [(), (2, 2)], ids=str)
def test_a_draw_of_a_pool_is_of_standard_normal_numbers(replicas):
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
    with pytest.raises(ValueError, match="draws must be at least 2, got 1"):
        NoisePool(1)


# ------------------------------------------------------------------------- shared by passes


class Draw(nn.Module):
    """Draws when called, so that its posterior's parameters can be swapped."""

    def __init__(self, posterior):
        super().__init__()
        self.posterior = posterior

    def forward(self):
        return self.posterior.sample()


@pytest.mark.parametrize("source", [None, NoisePool()], ids=["new", "pool"])
@pytest.mark.parametrize("kl", ["closed", "sampled", None])
def test_other_parameters_get_the_same_noise(kl, source):
    # large enough for replicas that are drawn a part at a time
    net = BayesMLP(150, 40, (150, 150), replicas=(5,), dtype=torch.double)
    other = {k: v.detach() - 0.5 for k, v in net.named_parameters()}
    posterior, noise = net.posterior, SharedNoise(source)
    with weight_scope("draw", noise=noise, kl=kl):
        first = posterior.weights()
    with weight_scope(noise=noise.again()):
        second = functional_call(Draw(posterior), other)
    epsilon = ((first - posterior.mu) / posterior.sigma).detach()
    assert epsilon.std() == pytest.approx(1, abs=5 * (2 * epsilon.numel()) ** -0.5)
    sigma = torch.nn.functional.softplus(other["posterior.rho"])
    torch.testing.assert_close(second, other["posterior.mu"] + sigma * epsilon)


def test_a_layer_that_draws_twice_shares_draw_by_draw():
    layer, x = BayesLinear(4, 4, prior_std=0.5), torch.randn(5, 4)
    noise = SharedNoise()
    with weight_scope(noise=noise.again()):
        first = [layer(x, "draw") for _ in range(2)]
    with weight_scope(noise=noise.again()):
        second = [layer(x, "draw") for _ in range(3)]
    assert not torch.equal(*first)
    for ours, theirs in zip(first, second, strict=False):
        assert torch.equal(ours, theirs)
    with weight_scope(noise=noise.again()):  # the draw that was one more is shared from now on
        third = [layer(x, "draw") for _ in range(3)]
    assert torch.equal(second[2], third[2])
    with (
        weight_scope(noise=noise.again()),
        pytest.raises(ValueError, match=r"draw of shape \[3, 20\] cannot share noise of shape"),
    ):
        layer.draw_weights((3,))
