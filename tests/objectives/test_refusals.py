"""Errors of losses, when they are created and when they are called."""

import pytest
import torch
from q_transitions import ACTIONS, FEATURES, bayes_loss, heads_loss, plain_loss, transitions
from torch import nn
from torch.nn.functional import one_hot
from torchrl.data import Categorical

from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import BBQNLoss, DropoutDQNLoss, NoisyDQNLoss


@pytest.mark.parametrize(
    ("make", "settings"),
    [
        (bayes_loss, {"target": "mean"}),
        (bayes_loss, {"target_noise": "shared"}),
        (bayes_loss, {"target_noise": "mean", "target": "mc"}),
        (bayes_loss, {"kl": "none"}),
        (bayes_loss, {"noise_std": 0.0}),
        (bayes_loss, {"gamma": torch.ones(2)}),
        (plain_loss, {"gamma": 1.5}),
        (heads_loss, {"loss_function": "huber"}),
        (plain_loss, {"action_space": "binary"}),
    ],
)
def test_settings_outside_of_what_is_listed(make, settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        make((3,), **settings)


def test_networks_that_do_not_fit():
    actor = q_actor(FlatMLP(FEATURES, ACTIONS), Categorical(ACTIONS))
    differing = nn.Sequential(*(FlatMLP(4, 4, replicas=n) for n in (2, 3)))
    for loss, network, word in (
        (BBQNLoss, actor, "Bayesian"),
        (NoisyDQNLoss, actor, "noisy"),
        (DropoutDQNLoss, q_actor(differing, Categorical(4)), "replica"),
    ):
        with pytest.raises(ValueError, match=word):
            loss(network)


def without_last(*key):
    return lambda td: td.set(key, td[key].squeeze(-1))


BATCHES = {
    "action_mask": lambda td: td["next"].pop("action_mask"),
    "action": lambda td: td.pop("action"),
    "observation": lambda td: td.pop("observation"),
    "terminated": lambda td: td["next"].pop("terminated"),
    "reward": without_last("next", "reward"),
    "reward' and 'terminated": without_last("next", "terminated"),
    "'action'": lambda td: td.set("action", one_hot(td["action"], ACTIONS)),
    "valid": lambda td: td.set("valid", torch.ones(2, 32, 3).bool()),
}


@pytest.mark.parametrize(("key", "spoil"), BATCHES.items(), ids=BATCHES)
def test_a_batch_that_lacks_an_entry_or_has_one_of_another_shape(make, key, spoil):
    loss, td = make((2,)), transitions((2,))
    td["valid"] = torch.ones(2, 32).bool()
    spoil(td)
    with pytest.raises((KeyError, ValueError), match=key):
        loss(td)


@pytest.mark.parametrize(("margin", "factor"), [(0, 1), (1, 0), (float("nan"), 1)])
def test_a_margin_and_a_factor_are_above_zero(margin, factor):
    with pytest.raises(ValueError, match=r"margin|factor"):
        plain_loss()[0].imitate(margin, factor)


def test_a_number_of_data_that_is_not_known():
    with pytest.raises(RuntimeError, match="num_data"):
        bayes_loss(num_data=None)[0](transitions())
