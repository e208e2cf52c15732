"""Transitions, actors, dynamics and reference computations for the tests of the losses."""

import pickle
from copy import deepcopy

import torch
from tensordict import TensorDict
from torchrl.data import Categorical
from torchrl.objectives import HardUpdate

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.networks import BootstrapMLP, FlatMLP, NoisyMLP, bootstrap_actor, q_actor
from bbq_torchrl.objectives import BBQNLoss, BootstrapDQNLoss, DropoutDQNLoss, NoisyDQNLoss
from bbq_torchrl.vime import DynamicsLoss, DynamicsModel

FEATURES, ACTIONS, BATCH, HEADS = 5, 4, 32, 3
REPLICAS = [(), (1,), (3,), (2, 2)]


def transitions(replicas=(), batch=(BATCH,), dtype=torch.float, *, features=FEATURES, ends=0.3):
    """Random transitions; some end, and no state forbids every action."""
    shape = (*replicas, *batch)

    def state():
        mask = torch.rand(*shape, ACTIONS) < 0.6
        mask[..., 1] = True
        return {"observation": torch.randn(*shape, features, dtype=dtype), "action_mask": mask}

    start = state()
    action = torch.distributions.Categorical(start["action_mask"].float()).sample()
    end = torch.rand(*shape, 1) < ends
    return TensorDict(
        {
            **start,
            "action": action,
            "next": {
                **state(),
                "reward": torch.randn(*shape, 1, dtype=dtype),
                "done": end,
                "terminated": end.clone(),
            },
        },
        shape,
    )


def off_prior(net):
    """The network, its posterior with means and spreads away from the prior."""
    with torch.no_grad():
        net.posterior.mu.normal_(0, 0.3)
        net.posterior.rho.uniform_(-3, -1)
    return net


def bayes_loss(replicas=(), *, hidden=(8, 8), dtype=torch.float, net=None, **settings):
    """A BBQN loss whose posterior and target lie away from the prior and from each other."""
    net = off_prior(net or BayesMLP(FEATURES, ACTIONS, hidden, replicas=replicas, dtype=dtype))
    loss = BBQNLoss(q_actor(net, Categorical(ACTIONS)), **{"num_data": 100, **settings})
    return away(loss)


def plain_loss(replicas=(), *, dropout=0.0, hidden=(8, 8), dtype=torch.float, **settings):
    """A DQN loss whose target lies away from the network."""
    net = FlatMLP(FEATURES, ACTIONS, hidden, replicas=replicas, dropout=dropout, dtype=dtype)
    loss = DropoutDQNLoss(q_actor(net, Categorical(ACTIONS)), **settings)
    return away(loss)


def heads_loss(replicas=(), *, hidden=(8, 8), trunk_layers=None, prior_scale=0.0, **settings):
    """A loss of bootstrap heads whose targets lie away from the network."""
    net = BootstrapMLP(
        FEATURES,
        ACTIONS,
        hidden,
        heads=HEADS,
        replicas=replicas,
        trunk_layers=trunk_layers,
        prior_scale=prior_scale,
        dtype=settings.pop("dtype", torch.float),
    )
    return away(BootstrapDQNLoss(bootstrap_actor(net, Categorical(ACTIONS)), **settings))


def noisy_loss(replicas=(), *, hidden=(), dtype=torch.float, kind=NoisyDQNLoss, **settings):
    """A NoisyNet loss whose target lies away from the network; one layer unless told."""
    net = NoisyMLP(FEATURES, ACTIONS, hidden, replicas=replicas, dtype=dtype)
    loss = kind(q_actor(net, Categorical(ACTIONS)), **settings)
    return away(loss)


def away(loss):
    """The loss, its parameters moved away from its targets, and what freezes those."""
    update = HardUpdate(loss, value_network_update_interval=0)
    with torch.no_grad():
        for parameter in loss.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return loss, update


class FixedNoise:
    """A source of the very noise that it is given."""

    def __init__(self, noise):
        self.noise = noise

    def normal(self, posterior, shape):
        return self.noise


def plain_mlp(x, layers):
    """One network by its definition, with autograd's gradients."""
    for k, (matrix, bias) in enumerate(layers):
        x = (x if k == 0 else x.relu()) @ matrix + bias
    return x


def flat(loss, name, *, target=False):
    """The only tensor of that name (mu, rho, weight, prior_rho) that the loss uses."""
    params = loss.target_value_network_params if target else loss.value_network_params
    found = [v for k, v in params.items(True, True) if (k if isinstance(k, str) else k[-1]) == name]
    assert len(found) == 1
    return found[0]


def elements(td, replicas):
    """The batch of each replica, one after the other."""
    return td.reshape(-1, *td.shape[len(replicas) :]) if replicas else td.unsqueeze(0)


def one_step_target(td, values, gamma, *, choice=None):
    """r + γ Q(s', a'), r at an end, for the legal action a' that the choice (or Q) says is best."""
    choice = values if choice is None else choice
    best = choice.masked_fill(~td["next", "action_mask"], -torch.inf).argmax(-1, keepdim=True)
    going_on = ~td["next", "terminated"]
    return td["next", "reward"] + gamma * going_on * values.gather(-1, best)


def assert_learns(loss, out, expected):
    """A loss returned the sum of each replica's expected one, and has its gradient."""
    torch.testing.assert_close(out["loss"], expected.sum())
    parameters = list(loss.parameters())
    torch.testing.assert_close(
        torch.autograd.grad(out["loss"], parameters),
        torch.autograd.grad(expected.sum(), parameters),
    )


# How a loss is copied, with another one at hand that was made alike.
COPIES = {
    "state": lambda loss, other: other.load_state_dict(loss.state_dict()) and other,
    "assigned": lambda loss, other: other.load_state_dict(loss.state_dict(), assign=True) and other,
    "deepcopy": lambda loss, _: deepcopy(loss),
    "pickle": lambda loss, _: pickle.loads(pickle.dumps(loss)),
}


def model(replicas=(), dtype=torch.float, **settings):
    """Returns a model whose weights differ from the prior, with its own statistics."""
    dynamics = DynamicsModel(FEATURES, ACTIONS, (8,), replicas=replicas, dtype=dtype, **settings)
    off_prior(dynamics.network)
    dynamics.update_statistics(1 + 2 * torch.randn(*replicas, 40, FEATURES, dtype=dtype))
    return dynamics


def dynamics_loss(replicas=(), dtype=torch.float, **settings):
    return DynamicsLoss(model(replicas, dtype), **{"num_data": 100, **settings})


def result(loss, td):
    torch.manual_seed(0)
    return loss(td)


def gradients(loss, td):
    return torch.autograd.grad(result(loss, td)["loss"], list(loss.parameters()))
