"""Noise out of a pool: independent normal numbers in each draw, none that two networks share."""

from __future__ import annotations

import pytest
import torch
from scipy import stats
from torch import nn

from bbq_torchrl.bayes import BayesLinear, BayesMLP, noise_pool, set_weight_mode, shared_noise
from bbq_torchrl.networks import FlatMLP

# A test of chance fails by chance with this probability.
RARE = 1e-6


def noise_of(net: BayesMLP, draws: int, pool: noise_pool) -> torch.Tensor:
    """The noise of some draws, [draws, *stack, P]: weights of a network with μ = 0, σ = 1."""
    net.posterior.reset_std_(1.0)
    with pool, torch.no_grad():
        return torch.stack([net.draw_weights() for _ in range(draws)])


@pytest.mark.parametrize("stack", [(), (3,), (2, 2)], ids=str)
def test_a_draw_is_of_standard_normal_numbers(stack):
    noise = noise_of(BayesMLP(60, 40, (50,), stack=stack), 1, noise_pool())

    assert noise.shape == (1, *stack, 61 * 50 + 51 * 40)
    assert stats.kstest(noise.flatten().double().numpy(), "norm").pvalue > RARE
    rows = noise.reshape(-1, noise.shape[-1]).double()
    neighbors = (rows[:, 1:] * rows[:, :-1]).sum() / rows[:, 1:].numel() ** 0.5
    assert abs(float(neighbors)) < 5


def test_one_weight_has_normal_noise_from_draw_to_draw():
    net, pool = BayesMLP(60, 40, (50,)), noise_pool(64)

    noise = noise_of(net, 400, pool)[:, ::997]

    # Windows lie where chance has it, and hardly ever in the same place twice.
    assert stats.kstest(noise.flatten().double().numpy(), "norm").pvalue > RARE
    assert len(noise[:, 0].unique()) > 390


def test_networks_of_a_stack_share_no_number_and_neither_do_layers():
    net = BayesMLP(30, 20, (), stack=(4,), dtype=torch.double)
    pool = noise_pool()
    own = [noise_of(net, 20, pool)[:, r].unique().tolist() for r in range(4)]
    own.append(noise_of(BayesMLP(30, 20, (), dtype=torch.double), 20, pool).unique().tolist())

    everything = [number for numbers in own for number in numbers]
    assert len(everything) == len(set(everything))


def test_the_pool_stays_until_it_is_cleared_and_comes_from_torchs_generator():
    net, pool = BayesMLP(30, 20, (), dtype=torch.double), noise_pool(2)

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
    net, pool = BayesMLP(30, 20, (), dtype=torch.double), noise_pool(2)
    with pool, torch.no_grad():
        rows = net.draw_weights((50,))
    assert len(rows.unique()) == rows.numel()


def test_only_what_draws_inside_is_concerned_and_pools_nest():
    net = nn.Sequential(BayesLinear(3, 40), BayesLinear(40, 2))
    outer, inner, x = noise_pool(2), noise_pool(2), torch.ones(3)
    with set_weight_mode("draw"):
        torch.manual_seed(0)
        with outer, inner:
            pass
        plain = net(x)
        torch.manual_seed(0)
        with outer:
            with inner:
                net(x)
            pooled = net(x)
        torch.manual_seed(0)
        assert torch.equal(net(x), plain)
    assert not torch.equal(pooled, plain)


def test_shared_noise_shares_what_comes_from_a_pool():
    net, noise = BayesMLP(3, 2), shared_noise()
    with noise_pool():
        with noise:
            first = net.draw_weights()
        with noise:
            second = net.draw_weights()
        assert torch.equal(first, second)
        assert not torch.equal(first, net.draw_weights())


def test_a_pool_of_one_draw_is_refused():
    with pytest.raises(ValueError, match="draws must be at least 2, got 1"):
        noise_pool(1)


@pytest.mark.parametrize("stack", [(), (3,)], ids=str)
@pytest.mark.parametrize("dropout", [0.2, 0.5])
def test_dropout_keeps_units_with_its_probability_and_changes_from_batch_to_batch(stack, dropout):
    # Inputs and weights of 1 leave the share of the units that are kept in the output.
    net = FlatMLP(1, 1, (200,), stack=stack, dropout=dropout)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.fill_(1.0)
    x = torch.ones(*stack, 64, 1)

    with noise_pool(), torch.no_grad():
        kept = torch.stack([(net(x, "draw") - 1) * (1 - dropout) / 2 for _ in range(20)])

    rows, units = kept.numel(), 200
    mean, error = (1 - dropout) * units, (dropout * (1 - dropout) * units / rows) ** 0.5
    # windows overlap: twenty batches are of the numbers of eight
    assert abs(float(kept.mean()) - mean) < 6 * error * (20 / 8) ** 0.5
    assert abs(float(kept.std()) / (error * rows**0.5) - 1) < 0.1
    assert len(kept.reshape(20, -1).unique(dim=0)) == 20


def test_networks_drop_units_of_their_own():
    net = FlatMLP(1, 1, (200,), stack=(2,), dropout=0.5)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.copy_(parameter[:1].expand_as(parameter))
    with noise_pool():
        first, second = net(torch.ones(2, 64, 1), "draw")
    assert not torch.equal(first, second)
