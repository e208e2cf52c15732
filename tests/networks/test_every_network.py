"""All networks and their actors: precision, derivatives, errors."""

import pickle
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Categorical, OneHot

from bbq_torchrl import networks
from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.networks.gaussian_process import StateFeatures

HEADS = partial(networks.BootstrapMLP, heads=3, trunk_layers=1, prior_scale=0.5)
SEPARATE = partial(networks.BootstrapMLP, heads=3, trunk_layers=0)


@pytest.mark.parametrize(
    ("make", "settings"),
    [(networks.FlatMLP, {}), (BayesMLP, {"mode": "draw"}), (HEADS, {})],
)
def test_values_and_gradients_in_bfloat16_are_near_those_in_float32(make, settings):
    net, x = make(5, 4, (64, 64), replicas=2), torch.randn(2, 32, 7, 5)
    found = []
    for enabled in (False, True):
        torch.manual_seed(0)  # one draw for both
        with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
            out = net(x, **settings)
        assert out.dtype == (torch.bfloat16 if enabled else torch.float32)
        found.append([out, *torch.autograd.grad(out.float().square().sum(), net.parameters())])
    for exact, rounded in zip(*found, strict=True):
        # bfloat16 has 8 bits: an error of 0.4 % for each rounding
        assert (rounded - exact).norm() < 0.1 * exact.norm()


class Zeros(nn.Module):
    def forward(self, x):
        return torch.zeros(*x.shape[:-1], 4)


def test_of_actions_of_one_value_one_legal_action_is_chosen():
    actor = pickle.loads(pickle.dumps(networks.q_actor(Zeros(), OneHot(4))))
    mask = torch.tensor([[False, True, False, True], [True] * 4])
    td = actor(TensorDict(observation=torch.ones(2, 2), action_mask=mask, batch_size=[2]))
    assert td["action"].tolist() == [[0, 1, 0, 0], [1, 0, 0, 0]]
    assert td["chosen_action_value"].tolist() == [[0], [0]]


# -- refusals ------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [networks.FlatMLP, BayesMLP, networks.NoisyMLP, HEADS, SEPARATE])
@pytest.mark.parametrize("shape", [(2, 8, 5), (3, 8, 6), (3,), (5,)])
def test_an_input_whose_shape_does_not_fit_is_refused(make, shape):
    with pytest.raises(ValueError, match="input"):
        make(5, 4, (6,), replicas=3)(torch.randn(shape))


MANY = Categorical(4, shape=(3,))


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        ("dropout", lambda: networks.FlatMLP(3, 2, dropout=-0.1)),
        ("dropout", lambda: networks.FlatMLP(3, 2, dropout=1.0)),
        ("mode", lambda: networks.FlatMLP(3, 2)(torch.ones(3), "off")),
        ("heads", lambda: networks.BootstrapMLP(3, 2, heads=0)),
        ("trunk_layers", lambda: networks.BootstrapMLP(3, 2, trunk_layers=3)),
        ("prior_scale", lambda: networks.BootstrapMLP(3, 2, prior_scale=torch.nan)),
        ("std_init", lambda: networks.NoisyMLP(4, 3, std_init=0.0)),
        ("inducing", lambda: StateFeatures(3, 0)),
        ("kernel", lambda: StateFeatures(3, 2, kernel="linear")),
        ("lengthscale", lambda: StateFeatures(3, 2, lengthscale=0)),
        ("prior_std", lambda: networks.GaussianProcess(StateFeatures(3, 2), 2, prior_std=0)),
        ("spec", lambda: networks.q_actor(nn.Linear(2, 4), MANY)),
        ("spec", lambda: networks.bootstrap_actor(nn.Linear(2, 4), MANY)),
    ],
)
def test_what_makes_no_network_or_actor_is_refused(key, wrong):
    with pytest.raises(ValueError, match=key):
        wrong()
