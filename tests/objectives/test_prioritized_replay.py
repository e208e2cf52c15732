"""The losses with TorchRL's prioritized replay buffer, whose sampler is in its C++ extension."""

from __future__ import annotations

import pytest
import torch
from q_transitions import transitions
from torchrl.data import LazyTensorStorage, TensorDictPrioritizedReplayBuffer

ALPHA, BETA = 0.7, 0.6
STATES, COPIES, STEPS = 4, 400, 600


@pytest.fixture
def buffer():
    """Makes a prioritized buffer of some rows; skips the test if TorchRL cannot."""

    def filled(rows, batch_size=32):
        try:
            made = TensorDictPrioritizedReplayBuffer(
                alpha=ALPHA,
                beta=BETA,
                priority_key="td_error",
                storage=LazyTensorStorage(len(rows)),
                batch_size=batch_size,
            )
        except RuntimeError as error:  # built for another version of torch than is installed
            pytest.skip(f"TorchRL's extension cannot be loaded: {error}")
        made.extend(rows)
        return made

    return filled


def test_rows_are_drawn_by_the_error_that_the_loss_writes(make, buffer):
    loss, rows = make(), transitions()
    replay = buffer(rows, batch_size=20_000)
    with torch.no_grad():
        torch.manual_seed(0)
        loss(rows)  # writes the squared error of each
        replay.update_priority(torch.arange(len(rows)), rows["td_error"].squeeze(-1))
    share = (rows["td_error"].squeeze(-1) + 1e-8) ** ALPHA
    share /= share.sum()
    drawn = replay.sample()
    found = drawn["index"].bincount(minlength=len(rows)) / len(drawn)
    assert ((found - share).abs() <= 5 * (share / len(drawn)).sqrt()).all()
    # and weighed by what that makes of the mean over the buffer
    weight = drawn["priority_weight"] * share[drawn["index"]] ** BETA
    torch.testing.assert_close(weight, weight[:1].expand_as(weight), rtol=1e-3, atol=0)
