"""Bayesian layers against torch's layers with the same weights: draws, KL, custom layers."""

from functools import partial
from itertools import product

import pytest
import torch
import torch.nn.functional as F
from q_transitions import FixedNoise
from torch.func import functional_call, vmap

from bbq_torchrl import bayes
from bbq_torchrl.bayes.posterior import posteriors

REPLICAS = [(), (3,), (2, 2)]


class BayesScale(bayes.BayesLayer):
    """A custom layer with one weight per feature."""

    def __init__(self, features, **settings):
        super().__init__([features], [1], **settings)

    def run(self, x, weights):
        extra = x.ndim - weights.ndim
        shape = (*weights.shape[:-1], *(1 for _ in range(extra)), weights.shape[-1])
        return x * weights.reshape(shape)


# name -> (layer, the features of an input)
LAYERS = {
    "linear": (partial(bayes.BayesLinear, 4, 3), (4,)),
    "mlp": (partial(bayes.BayesMLP, 4, 3, (5,)), (4,)),
    "conv": (partial(bayes.BayesConv2d, 2, 3, (3, 2), stride=2, padding=1), (2, 6, 5)),
    "own": (partial(BayesScale, 4), (4,)),
}


def made(name, **settings):
    make, features = LAYERS[name]
    net = make(**{"dtype": torch.double, **settings})
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.uniform_(-1, 0.5)
    return net, features


@pytest.mark.parametrize("replicas", REPLICAS, ids=str)
@pytest.mark.parametrize("name", LAYERS)
def test_a_replica_is_a_separate_layer(name, replicas):
    net, features = made(name, replicas=replicas)
    alone, _ = made(name)
    (own,) = posteriors(net)
    x = torch.randn(*replicas, 6, *features).double()
    for rows in ((), (6,)):  # one draw for all, and rows with weights of their own
        weights = own.sample(rows)
        out = net(x, weights=weights)
        for index in product(*map(range, (*replicas, *rows))):
            torch.testing.assert_close(out[index], alone(x[index], weights=weights[index]))


@pytest.mark.parametrize(
    "settings", [{}, {"stride": 2, "padding": 1}, {"stride": (1, 2), "padding": (2, 0)}], ids=str
)
def test_a_convolution_is_torchs(settings):
    net = bayes.BayesConv2d(2, 4, (3, 2), dtype=torch.double, **settings)
    x, weights = torch.randn(5, 2, 8, 7).double(), net.draw_weights()
    expected = F.conv2d(x, weights[:-4].reshape(4, 2, 3, 2), weights[-4:], **settings)
    torch.testing.assert_close(net(x, weights=weights), expected)
    torch.testing.assert_close(net(x[0], weights=weights), expected[0])


@pytest.mark.parametrize("name", ["linear", "mlp", "conv"])
def test_mode_local_is_a_separate_weight_draw_for_each_row(name):
    # mean and covariance of the outputs of one input, by either way
    net, features = made(name)
    (posterior,) = posteriors(net)
    n = 20_000
    x = torch.randn(features).double().expand(n, *features)
    with torch.no_grad():
        local = net(x, "local").flatten(1)
        drawn = net(x, weights=posterior.sample((n,))).flatten(1)
    spread = drawn.std(0)
    assert ((local.mean(0) - drawn.mean(0)).abs() < 8 * spread * n**-0.5).all()
    scale = spread.unsqueeze(0) * spread.unsqueeze(1)
    # a covariance of n pairs has a standard deviation of about scale · √(2/n)
    assert ((local.T.cov() - drawn.T.cov()).abs() < 10 * scale * (2 / n) ** 0.5 + 1e-9).all()


@pytest.mark.parametrize(
    ("name", "shape", "mode"), [("conv", (5, 3, 8, 7), "mean"), ("own", (2, 4), "local")]
)
def test_shapes_and_local_noise_that_would_be_no_weight_draw_are_refused(name, shape, mode):
    with pytest.raises(ValueError, match=r"shape|local"):
        made(name)[0](torch.randn(shape).double(), mode)


@pytest.mark.parametrize("kind", ["closed", "sampled"])
def test_gradients_under_a_transform_are_the_hand_written_ones(kind):
    net, _ = made("mlp", prior_std=0.3)
    x = torch.randn(6, 4).double()
    noise = torch.randn_like(net.posterior.mu)

    def value(parameters):
        with bayes.weight_scope("draw", noise=FixedNoise(noise), kl=kind) as scope:
            out = functional_call(net, parameters, (x,))
            return out.square().sum() + scope.kl.total()

    parameters = dict(net.named_parameters())
    gradients = torch.autograd.grad(value(parameters), list(parameters.values()))
    expected = dict(zip(parameters, gradients, strict=True))
    torch.testing.assert_close(torch.func.grad(value)(parameters), expected)
    twice = {key: torch.stack([p, p]).detach() for key, p in parameters.items()}
    each = vmap(torch.func.grad(value))(twice)
    torch.testing.assert_close({key: grad[1] for key, grad in each.items()}, expected)
