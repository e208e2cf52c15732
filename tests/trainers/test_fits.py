"""Losses that learn from all stored transitions at once, with and without mini-batches."""

import pytest
import torch
import trainer_parts
from tensordict import TensorDict
from trainer_parts import CountingLoss


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
