"""The masks of heads that learn from a transition."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, SamplerWithoutReplacement, TensorDictReplayBuffer

from bbq_torchrl.data import BootstrapMask


def masks(transform, *batch, valid=None):
    td = TensorDict(batch_size=batch)
    return transform.inv(td if valid is None else td.set("valid", valid))["bootstrap_mask"]


@pytest.mark.parametrize("prob", [0.5, 0.1, 1.0])
def test_heads_learn_from_their_share_independently(prob):
    n, heads = 20_000, 6
    mask = masks(BootstrapMask(heads, prob), n)
    assert mask.dtype == torch.bool
    mask = mask.double() - prob
    # means of n numbers with variance p (1 - p); of products of independent ones, its square
    error = prob * (1 - prob) / n**0.5
    assert (mask.mean(0).abs() <= 5.5 * (prob * (1 - prob) / n) ** 0.5).all()
    between_heads = (mask.T @ mask / n).fill_diagonal_(0)
    between_rows = mask[1:].T @ mask[:-1] / n
    for covariance in (between_heads, between_rows):
        assert (covariance.abs() <= 6 * error).all()


def test_a_mask_that_is_there_stays_and_takes_no_number():
    transform = BootstrapMask(4)
    state = transform.generator_state.clone()
    given = TensorDict(bootstrap_mask=torch.ones(6, 4, dtype=torch.bool), batch_size=[6])
    assert transform.inv(given)["bootstrap_mask"].all()
    assert torch.equal(transform.generator_state, state)


def test_torchrls_replay_buffer_keeps_each_transitions_mask():
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(100),
        sampler=SamplerWithoutReplacement(),
        transform=BootstrapMask(4),
        batch_size=10,
    )
    rows = TensorDict(number=torch.arange(30), valid=torch.arange(30) != 3, batch_size=[30])
    buffer.extend(rows)
    assert "bootstrap_mask" not in rows
    buffer.add(TensorDict(number=torch.tensor(30), valid=torch.tensor(True)))
    stored = buffer[:]["bootstrap_mask"].clone()
    assert stored.shape == (31, 4)
    assert stored.any()
    assert not stored[3].any()
    for _ in range(7):
        batch = buffer.sample()
        assert torch.equal(batch["bootstrap_mask"], stored[batch["number"]])


@pytest.mark.parametrize(
    "settings", [{"heads": 0}, {"prob": 0.0}, {"prob": 1.5}, {"prob": torch.nan}]
)
def test_what_does_not_fit_is_refused(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        BootstrapMask(**{"heads": 4, **settings})
    with pytest.raises(ValueError, match="batch size"):
        masks(BootstrapMask(4, replicas=(3,)), 2, 5)
    with pytest.raises(ValueError, match="seeds"):
        BootstrapMask(4, replicas=(3,)).set_seeds([1])
