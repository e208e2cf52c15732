"""Errors of losses, when they are created and when they are called."""

from __future__ import annotations

import pytest
import torch
from q_transitions import ACTIONS, FEATURES, HEADS, bayes_loss, heads_loss, plain_loss, transitions
from torch import nn
from torch.nn.functional import one_hot
from torchrl.data import Categorical

from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import BBQNLoss, BootstrapDQNLoss, DropoutDQNLoss, NoisyDQNLoss

ACTOR = q_actor(FlatMLP(FEATURES, ACTIONS), Categorical(ACTIONS))
TWO_REPLICAS, THREE_REPLICAS = (FlatMLP(4, 4, replicas=n) for n in (2, 3))


@pytest.mark.parametrize(
    ("make", "settings", "words"),
    [
        (bayes_loss, {"target": "mean"}, r"target must be one of map, mc, got 'mean'"),
        (bayes_loss, {"target_noise": "shared"}, r"one of \['mean'\] or None for target='map'"),
        (bayes_loss, {"target_noise": "independent"}, r"'map', got 'independent'"),
        (
            bayes_loss,
            {"target": "mc", "target_noise": "mean"},
            r"target_noise must be one of \['independent', 'shared'\] or None for target='mc', got",
        ),
        (bayes_loss, {"kl": "none"}, r"kl must be one of closed, sampled, got 'none'"),
        (bayes_loss, {"noise_std": 0.0}, "noise_std must be positive and finite, got 0.0"),
        (bayes_loss, {"kl_temperature": -1}, "kl_temperature must be at least 0 and finite, got"),
        (bayes_loss, {"num_data": 0}, "num_data must be positive, got 0"),
        (bayes_loss, {"num_data": torch.ones(2)}, r"num_data must .* shape \[3\], got \[2\]"),
        (bayes_loss, {"gamma": torch.ones(2)}, r"gamma must .* shape \[3\], got \[2\]"),
        (plain_loss, {"gamma": -0.5}, "gamma must be a number between 0 and 1, got -0.5"),
        (plain_loss, {"gamma": 1.5}, "gamma must be a number between 0 and 1, got 1.5"),
        (heads_loss, {"loss_function": "huber"}, r"must be one of l2, l1, smooth_l1"),
        (plain_loss, {"action_space": "binary"}, "must be categorical or one-hot, got binary"),
    ],
)
def test_settings_outside_of_what_is_listed(make, settings, words):
    with pytest.raises(ValueError, match=words):
        make((3,), **settings)


def replicas(value):
    """An actor whose network has these replicas."""
    net = nn.Linear(FEATURES, ACTIONS)
    net.replicas = value
    return q_actor(net, Categorical(ACTIONS))


@pytest.mark.parametrize(
    ("loss", "actor", "words"),
    [
        (BBQNLoss, ACTOR, "Thompson sampling need a network with Bayesian layers"),
        (NoisyDQNLoss, ACTOR, "NoisyNet needs a network with noisy layers"),
        (
            DropoutDQNLoss,
            q_actor(nn.Sequential(TWO_REPLICAS, THREE_REPLICAS), Categorical(4)),
            "must share one replica shape",
        ),
        *(
            (DropoutDQNLoss, replicas(value), "must be an integer or a tuple of integers, got .*2")
            for value in ("2", 2.0, (2.0,), torch.tensor(2))
        ),
    ],
)
def test_networks_that_do_not_fit(loss, actor, words):
    with pytest.raises(ValueError, match=words):
        loss(actor)


def without_last(*key):
    return lambda td: td.set(key, td[key].squeeze(-1))


MISSING_MASK = r"'next', 'action_mask'.* is missing.*action_mask_key=None"
NO_COLUMN = r"'reward' and 'terminated' must have shape \[\*batch, 1\], got .*32\]"
BATCHES = {
    "no legal actions": (lambda td: td["next"].pop("action_mask"), KeyError, MISSING_MASK),
    "no action": (lambda td: td.pop("action"), KeyError, 'key "action" not found'),
    "no state": (lambda td: td.pop("observation"), KeyError, 'key "observation" not found'),
    "no end": (lambda td: td["next"].pop("terminated"), KeyError, 'key "terminated" not found'),
    "flat reward": (without_last("next", "reward"), ValueError, NO_COLUMN),
    "flat end": (without_last("next", "terminated"), ValueError, NO_COLUMN),
    "one-hot action": (
        lambda td: td.set("action", one_hot(td["action"], ACTIONS)),
        ValueError,
        r"'action' must be categorical with batch \[2, 32\], .*, got \[2, 32, 4\]",
    ),
    "action that is no integer": (
        lambda td: td.set("action", td["action"].float()),
        ValueError,
        "'action' must be of an integer dtype, got torch.float32",
    ),
    "mask of another shape": (
        lambda td: td.set("valid", torch.ones(2, 32, 3).bool()),
        ValueError,
        r"'valid' must have the batch shape \[2, 32\], got \[2, 32, 3\]",
    ),
}


@pytest.mark.parametrize(("spoil", "error", "words"), BATCHES.values(), ids=BATCHES)
def test_a_batch_that_lacks_an_entry_or_has_one_of_another_shape(make, spoil, error, words):
    loss, td = make((2,)), transitions((2,))
    td["valid"] = torch.ones(2, 32).bool()
    spoil(td)
    with pytest.raises(error, match=words):
        loss(td)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int16, torch.int32])
def test_an_action_of_any_integer_dtype_is_learned_from(dtype):
    found = []
    for kind in (dtype, torch.int64):
        torch.manual_seed(0)
        td = transitions((2,))
        td["action"] = td["action"].to(kind)
        found.append(plain_loss((2,))[0](td)["loss"])
    assert torch.equal(*found)


@pytest.mark.parametrize(
    ("shape", "allowed"),
    [
        ((2, 32, HEADS + 1), "2, 32, 3"),
        ((2, 32, 1), "2, 32, 3"),
        ((2, 32), "2, 32, heads"),
        ((2, 31, HEADS), "2, 32, heads"),
    ],
)
def test_a_mask_of_other_heads(shape, allowed):
    td = transitions((2,)).auto_batch_size_(1)
    td["bootstrap_mask"] = torch.ones(shape).bool()
    with pytest.raises(ValueError, match=rf"'bootstrap_mask' must have shape \[{allowed}\], got"):
        heads_loss((2,))[0](td)


def test_values_without_heads():
    loss = BootstrapDQNLoss(ACTOR, delay_value=False)
    words = r"must return values \[\*batch, heads, actions\] with batch \[32\], got \[32, 4\]"
    with pytest.raises(ValueError, match=words):
        loss(transitions())


def test_a_number_of_data_that_is_not_known():
    words = r"num_data is unknown: pass it to BBQNLoss or call set_num_data\(n\)"
    with pytest.raises(RuntimeError, match=words):
        bayes_loss(num_data=None)[0](transitions())
