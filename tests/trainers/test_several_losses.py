"""Several losses trained together: the sum of their losses."""

from types import SimpleNamespace

import pytest
import torch
from dynamics_losses import dynamics_loss
from q_transitions import bayes_loss, plain_loss, transitions

from bbq_torchrl.trainers import Learner
from bbq_torchrl.vime import vime_losses


class Still:
    """An optimizer that neither steps nor clears the gradients."""

    replicas = 2

    def zero_grad(self):
        pass

    def step(self, active=None):
        pass

    def scale_lr(self, share):
        pass

    def state_dict(self):
        pass

    def load_state_dict(self, state_dict):
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
    losses = vime_losses(q_loss, dynamics)
    learner = Learner(losses, None, Still(), None, batch_size=2, freezes=1, epochs=1)
    learner.update(learned)

    torch.testing.assert_close(gradients(q_loss, dynamics), expected)
    assert learner.sums.means().keys() == names
