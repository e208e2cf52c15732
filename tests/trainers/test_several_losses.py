"""Several losses trained together: the sum of their losses, and the state of 0.1's VIMELoss."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from dynamics_losses import dynamics_loss, result
from q_transitions import bayes_loss, plain_loss, transitions
from torch import nn

from bbq_torchrl.trainers import losses_of
from bbq_torchrl.trainers.learn import Update
from bbq_torchrl.vime import vime_losses


class Still:
    """An optimizer that neither steps nor clears the gradients."""

    replicas = 2

    def zero_grad(self):
        pass

    def step(self, active=None):
        pass


def batch():
    return SimpleNamespace(transitions=transitions((2,)), active=[True, True])


def gradients(*losses):
    return [p.grad for loss in losses for p in loss.parameters() if p.requires_grad]


@pytest.mark.parametrize("q", [lambda r: plain_loss(r, dropout=0.5), bayes_loss])
def test_an_update_has_the_gradients_and_the_metrics_of_each_loss(q):
    q_loss, dynamics, learned = q((2,))[0], dynamics_loss((2,)), batch()
    torch.manual_seed(0)
    for loss in (q_loss, dynamics):
        loss(learned.transitions)["loss"].backward()
    expected = [gradient.clone() for gradient in gradients(q_loss, dynamics)]
    names = {*q_loss.out_keys, *dynamics.out_keys} - {"loss"}

    for gradient in gradients(q_loss, dynamics):
        gradient.zero_()
    torch.manual_seed(0)
    update = Update(vime_losses(q_loss, dynamics), Still())
    update(learned)

    torch.testing.assert_close(gradients(q_loss, dynamics), expected)
    assert update.sums.means().keys() == names


def test_losses_are_those_of_a_module_dict_or_the_one_given():
    q_loss, dynamics = nn.Linear(1, 1), nn.Linear(1, 1)
    assert losses_of(q_loss) == [q_loss]
    assert losses_of(nn.ModuleDict({"first": q_loss, "second": dynamics})) == [q_loss, dynamics]


def test_a_state_of_the_loss_that_was_both_is_read():
    losses, other = (vime_losses(plain_loss((2,))[0], dynamics_loss((2,), every=3)) for _ in "ab")
    for _ in range(2):
        result(losses["dynamics_loss"], transitions((2,)))
    state = dict(losses.state_dict())
    state["held"] = state.pop("dynamics_loss.reported")
    state["_extra_state"] = state.pop("dynamics_loss._extra_state")

    other.load_state_dict(state)

    assert other["dynamics_loss"].batches == 2
    assert torch.equal(other["dynamics_loss"].reported, losses["dynamics_loss"].reported)
    for name, value in losses.state_dict().items():
        assert torch.equal(other.state_dict()[name], value)
