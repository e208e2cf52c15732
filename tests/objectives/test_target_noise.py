"""Where the target's noise comes from: the mean, a draw of its own, the online draw."""

from __future__ import annotations

import pytest
import torch
from q_transitions import ACTIONS, FEATURES, REPLICAS, bayes_loss, transitions
from torch import nn
from torchrl.data import Categorical
from torchrl.objectives import HardUpdate

from bbq_torchrl.bayes import BayesLinear
from bbq_torchrl.networks import q_actor
from bbq_torchrl.objectives import BBQNLoss


def both_values(loss, td):
    """The online draw's values and the target's, of the same states."""
    online, target = loss._tensors()
    inputs = [td["observation"]]
    values, _ = loss._predict(online, inputs)
    return values.detach(), loss._target_values(target, inputs).detach()


def several_layers(replicas=(), **settings):
    net = nn.Sequential(
        BayesLinear(FEATURES, 8, replicas=replicas, prior_std=0.5),
        nn.Tanh(),
        BayesLinear(8, 8, replicas=replicas, prior_std=0.5),
        nn.ReLU(),
        BayesLinear(8, ACTIONS, replicas=replicas, prior_std=0.5),
    )
    loss = BBQNLoss(q_actor(net, Categorical(ACTIONS)), num_data=100, target="mc", **settings)
    return loss, HardUpdate(loss, value_network_update_interval=0)


@pytest.mark.parametrize(
    ("target", "expected"), [("map", "mean"), ("mc", "independent"), (None, "mean")]
)
def test_the_target_decides_unless_something_is_said(target, expected):
    settings = {} if target is None else {"target": target}
    assert bayes_loss(**settings)[0].target_noise == expected
    assert bayes_loss(target_noise=expected, **settings)[0].target_noise == expected


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("kl", ["closed", "sampled"])
@pytest.mark.parametrize("make", [bayes_loss, several_layers])
def test_with_equal_parameters_the_shared_target_is_the_online_draw(replicas, kl, make):
    loss, update = make(replicas, **{"target": "mc"} if make is bayes_loss else {}, kl=kl)
    for noise in ("shared", "independent"):
        loss.target_noise = noise
        update.step()
        values, target = both_values(loss, transitions(replicas))
        assert torch.equal(values, target) == (noise == "shared")
        assert noise == "shared" or (values != target).any(-1).all()


def test_each_batch_has_noise_of_its_own_and_none_outlives_it():
    loss, update = bayes_loss(target="mc", target_noise="shared")
    update.step()
    td = transitions()
    first, second = both_values(loss, td), both_values(loss, td)
    assert (first[0] != second[0]).any(-1).all()
    assert torch.equal(second[0], second[1])
    # a target without a prediction before it has no noise to share
    _, target = loss._tensors()
    alone = loss._target_values(target, [td["observation"]])
    assert (alone != second[1]).any(-1).all()
