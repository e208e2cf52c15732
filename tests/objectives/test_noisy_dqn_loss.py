"""NoisyDQNLoss against its definition in plain torch, and what it learns."""

from __future__ import annotations

import pytest
import torch
from q_transitions import ACTIONS, REPLICAS, elements, noisy_loss, transitions
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.networks import FlatMLP, ReplicaNoisyLinear, q_actor
from bbq_torchrl.objectives import DropoutDQNLoss, NoisyDQNLoss

KINDS = ("weight_mu", "weight_sigma", "bias_mu", "bias_sigma")


@pytest.fixture
def noise(monkeypatch):
    """Records the normal numbers z of calls, in order, by a scaling of their own."""
    drawn = []

    def scale(self, size):
        drawn.append(torch.randn(size, dtype=torch.double))
        return drawn[-1].sign() * drawn[-1].abs().sqrt()

    monkeypatch.setattr(ReplicaNoisyLinear, "_scale_noise", scale)
    return drawn


def layers_of(params, k):
    """The four tensors of each layer of element k."""
    params = params["module", "0", "module", "layers"]
    replica_ndim = params["0", "bias_mu"].ndim - 1
    return [
        [
            params[str(n), kind].flatten(0, replica_ndim - 1)[k]
            if replica_ndim
            else params[str(n), kind]
            for kind in KINDS
        ]
        for n in range(len(params.keys()))
    ]


def network(layers, x, z=None):
    """One noisy network by its definition; z: the normal numbers in, out of each layer."""
    for n, (weight, weight_sigma, bias, bias_sigma) in enumerate(layers):
        if z is not None:
            e_in, e_out = (v.sign() * v.abs().sqrt() for v in z[2 * n : 2 * n + 2])
            weight = weight + weight_sigma * e_out[:, None] * e_in[None]
            bias = bias + bias_sigma * e_out
        x = (x if n == 0 else x.relu()) @ weight.T + bias
    return x


def definition(loss, td, noises, replicas, gamma, double_dqn, with_target_noise=True):
    """Each element's loss for the noise that was drawn: online, target, choice."""
    count, depth = torch.Size(replicas).numel(), 6
    losses = []
    for k, batch in enumerate(elements(td, replicas)):
        z = [v.reshape(count, -1)[k] for v in noises]
        online, frozen = (
            layers_of(p, k) for p in (loss.value_network_params, loss.target_value_network_params)
        )
        chosen = network(online, batch["observation"], z[:depth])
        chosen = chosen.gather(-1, batch["action"].unsqueeze(-1)).squeeze(-1)
        following, illegal = batch["next", "observation"], ~batch["next", "action_mask"]
        target_z = z[depth : 2 * depth] if with_target_noise else None
        values = network(frozen, following, target_z).masked_fill(illegal, -torch.inf)
        best = values.argmax(-1, keepdim=True)
        if double_dqn:
            choice_z = z[2 * depth :] if with_target_noise else None
            choice = network(online, following, choice_z).masked_fill(illegal, -torch.inf)
            best = choice.argmax(-1, keepdim=True)
        value = values.gather(-1, best).squeeze(-1)
        going_on = ~batch["next", "terminated"].squeeze(-1)
        y = batch["next", "reward"].squeeze(-1) + gamma * going_on * value
        losses.append((y.detach() - chosen).square().mean())
    return torch.stack(losses).reshape(replicas)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("double_dqn", [False, True])
@pytest.mark.parametrize("kind", [NoisyDQNLoss, DropoutDQNLoss])
def test_value_and_gradient_are_those_of_the_definition(noise, replicas, double_dqn, kind):
    loss, _ = noisy_loss(
        replicas, hidden=(8, 6), dtype=torch.double, double_dqn=double_dqn, gamma=0.8, kind=kind
    )
    td = transitions(replicas, dtype=torch.double)
    out = loss(td)
    has_target_noise = kind is NoisyDQNLoss
    assert len(noise) == 6 * (1 + has_target_noise + (has_target_noise and double_dqn))
    expected = definition(loss, td, noise, replicas, 0.8, double_dqn, has_target_noise)
    torch.testing.assert_close(out["loss_value"], expected.detach())
    torch.testing.assert_close(out["loss"], expected.sum())
    parameters = list(loss.parameters())
    torch.testing.assert_close(
        torch.autograd.grad(out["loss"], parameters),
        torch.autograd.grad(expected.sum(), parameters),
    )


@pytest.mark.parametrize("exploration", [None, *ExplorationType])
def test_noise_is_on_under_every_exploration_type(exploration):
    # TorchRL runs forward under DETERMINISTIC, where its NoisyLinear is its mean
    loss, _ = noisy_loss((2,), hidden=(8,))
    td = transitions((2,))
    with set_exploration_type(exploration):
        out = loss(td)
    out["loss"].backward()
    for name, parameter in loss.named_parameters():
        assert parameter.grad.any(), name
    targets = [loss._td_target(td["next"], *loss._tensors()) for _ in range(2)]
    going_on = ~td["next", "terminated"]
    assert (targets[0] != targets[1])[going_on].any()
    assert torch.equal(targets[0][~going_on], targets[1][~going_on])


def test_a_network_without_noise_is_refused():
    with pytest.raises(ValueError, match="NoisyNet needs a network with noisy layers"):
        NoisyDQNLoss(q_actor(FlatMLP(5, ACTIONS), Categorical(ACTIONS)))
    with pytest.raises(ValueError, match=r"gamma must be in \[0, 1\], got 2"):
        noisy_loss(gamma=2.0)
