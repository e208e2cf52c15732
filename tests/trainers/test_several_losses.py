"""Losses trained together, and losses that learn from all stored transitions at once."""

from types import SimpleNamespace

import pytest
import torch
import trainer_parts
from dynamics_losses import dynamics_loss
from q_transitions import bayes_loss, plain_loss, transitions
from tensordict import TensorDict
from trainer_parts import CountingLoss

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


class Fits(CountingLoss):
    """Notes what it is called with."""

    only_fits = True

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.calls = []

    def forward(self, tensordict):
        self.calls.append("batch")
        return super().forward(tensordict)

    def fit(self, tensordict):
        self.calls.append(tensordict.clone())
        return TensorDict(loss_value=torch.tensor([7.0, 8.0]), fitted=torch.tensor([1.0, 2.0]))


@pytest.mark.parametrize("only_fits", [True, False])
def test_a_round_ends_with_a_fit_to_all_transitions(only_fits, tmp_path, monkeypatch):
    monkeypatch.setattr(trainer_parts, "CountingLoss", Fits)
    monkeypatch.setattr(Fits, "only_fits", only_fits)
    trainer = trainer_parts.make_trainer(tmp_path, replicas=2, rounds=1)
    rows = trainer.train()

    *batches, stored = trainer.learner.loss.calls
    assert ("batch" in batches) is not only_fits
    assert stored["valid"].sum(-1).tolist() == list(trainer.replay.lengths)
    for replica, buffer in enumerate(trainer.replay.buffers):
        seen = stored["observation"][replica][stored["valid"][replica]]
        kept = buffer.storage.get(slice(0, len(buffer)))["observation"]
        assert torch.equal(seen.unique(dim=0), kept.unique(dim=0))
        assert not torch.equal(seen, kept)  # they are shuffled
    assert [row["loss"] for row in rows] == [7.0, 8.0]
    assert [row["fitted"] for row in rows] == [1.0, 2.0]
    assert ("td_error" in rows[0]) is not only_fits
    assert (rows[0]["updates"] > 0) is not only_fits
