"""Draws of the Q-values of a policy."""

import pytest
import torch
from torchrl.data import Categorical

from bbq_torchrl.exploration import Greedy
from bbq_torchrl.exploration.draws import q_draws
from bbq_torchrl.networks import FlatMLP, q_actor


def test_dropout_is_a_posterior():
    """Of a network with one hidden unit, the values with and without it are all there is."""
    network = FlatMLP(2, 3, (1,), dropout=0.25)
    with torch.no_grad():
        network.weight.copy_(torch.tensor([1.0, 1.0, 0.0, 3.0, 6.0, 9.0, 0.5, 0.5, 0.5]))
    policy = Greedy(q_actor(network, Categorical(3), action_mask_key=None)).eval()
    draws = q_draws(policy, torch.tensor([[1.0, 1.0]]), 4_000)
    on = 0.5 + torch.tensor([3.0, 6.0, 9.0]) * 2 / 0.75
    is_on = (draws - on).abs().amax(-1) < 1e-4
    assert torch.equal(draws[~is_on], torch.full_like(draws[~is_on], 0.5))
    assert is_on.float().mean() == pytest.approx(0.75, abs=0.03)
    network.dropout = 0.0
    assert q_draws(policy, torch.tensor([[1.0, 1.0]]), 9) is None
