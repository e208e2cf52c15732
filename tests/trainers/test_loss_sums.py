"""Sums of what a loss reports: exact, in order, and each replica's own."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.data import Batch
from bbq_torchrl.trainers.errors import TrainingError
from bbq_torchrl.trainers.learn import LossSums


def added(sums: LossSums, values: torch.Tensor, *active: bool) -> None:
    """Adds an update that reported values [2, replicas] of a batch that is active for some."""
    reported = TensorDict({"loss_value": values[0], "kl": values[1], "loss": values.sum()})
    valid = torch.tensor(active).unsqueeze(-1)
    sums.add(reported, Batch(TensorDict(valid=valid), active))


@pytest.mark.parametrize("updates", [1, 63, 64, 65, 200])
def test_sums_of_many_updates_are_those_of_one_after_the_other(updates):
    values = torch.randn(updates, 2, 3) * 10.0 ** torch.randint(-6, 6, (updates, 2, 3))
    sums = LossSums(3)
    expected = torch.zeros(2, 3, dtype=torch.float64)

    for update in values:
        added(sums, update, True, True, True)
        expected += update

    assert sums.means()["loss_value"] == [float(total) / updates for total in expected[0]]


def test_a_replicas_sums_do_not_depend_on_the_updates_of_another():
    values = torch.randn(150, 2, 2)
    alone, beside = LossSums(2), LossSums(2)
    for number, update in enumerate(values):
        if number < 100:
            added(alone, update, True, True)
        added(beside, update, number < 100, True)
    for name, means in alone.means().items():
        assert beside.means()[name][0] == means[0]
    assert beside.updates == [100, 150]


@pytest.mark.parametrize(
    ("reported", "got"),
    [
        ({"loss": torch.zeros(())}, "none"),
        ({"loss_value": torch.zeros(())}, r"shape \[\]"),
    ],
)
def test_a_loss_without_replicas_is_refused_with_where_to_look(reported, got):
    batch = Batch(TensorDict(valid=torch.ones(2, 1)), (True, True))
    with pytest.raises(
        TrainingError,
        match=rf"^the loss must return loss_value of shape \[2\], got {got}: does the network have "
        r"\.replicas, and is the loss one of bbq_torchrl\.objectives\?$",
    ):
        LossSums(2).add(TensorDict(reported), batch)
