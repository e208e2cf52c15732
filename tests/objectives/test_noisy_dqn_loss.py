"""NoisyDQNLoss against its definition in plain torch, and what it learns."""

from __future__ import annotations

import pytest
import torch
from q_transitions import ACTIONS, REPLICAS, noisy_loss, transitions
from torch.func import functional_call
from torchrl.data import Categorical

from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import DropoutDQNLoss, NoisyDQNLoss


def parameters_of(params):
    """Parameters of the network in an actor's, as ``functional_call`` takes them."""
    return dict(params["module", "0", "module"].flatten_keys(".").items())


def definition(loss, td, gamma, double_dqn, target_mode):
    """Each replica's loss; the noises are drawn in this order: online, target, choice."""
    net = loss.value_network[0].module
    own, frozen = loss.value_network_params, loss.target_value_network_params
    own, frozen = parameters_of(own), parameters_of(frozen)
    following, legal = td["next", "observation"], td["next", "action_mask"]
    values = functional_call(net, own, (td["observation"], "draw"))
    chosen = values.gather(-1, td["action"].unsqueeze(-1))
    target = functional_call(net, frozen, (following, target_mode))
    choice = functional_call(net, own, (following, target_mode)) if double_dqn else target
    best = choice.masked_fill(~legal, -torch.inf).argmax(-1, keepdim=True)
    going_on = ~td["next", "terminated"]
    y = td["next", "reward"] + gamma * going_on * target.gather(-1, best)
    return (y.detach() - chosen).square().mean((-2, -1))


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("double_dqn", [False, True])
@pytest.mark.parametrize(
    ("kind", "target_mode"), [(NoisyDQNLoss, "draw"), (DropoutDQNLoss, "mean")]
)
def test_value_and_gradient_are_those_of_the_definition(replicas, double_dqn, kind, target_mode):
    loss, _ = noisy_loss(
        replicas, hidden=(8, 6), dtype=torch.double, double_dqn=double_dqn, gamma=0.8, kind=kind
    )
    td = transitions(replicas, dtype=torch.double)
    torch.manual_seed(0)
    out = loss(td)
    torch.manual_seed(0)
    expected = definition(loss, td, 0.8, double_dqn, target_mode)
    torch.testing.assert_close(out["loss_value"], expected.detach())
    torch.testing.assert_close(out["loss"], expected.sum())
    parameters = list(loss.parameters())
    torch.testing.assert_close(
        torch.autograd.grad(out["loss"], parameters),
        torch.autograd.grad(expected.sum(), parameters),
    )


def test_a_network_without_noise_is_refused():
    with pytest.raises(ValueError, match="NoisyNet needs a network with noisy layers"):
        NoisyDQNLoss(q_actor(FlatMLP(5, ACTIONS), Categorical(ACTIONS)))
    with pytest.raises(ValueError, match="gamma must be at least 0 and at most 1, got 2"):
        noisy_loss(gamma=2.0)
