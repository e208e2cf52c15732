"""Which heads learn from a transition."""

from __future__ import annotations

import io
import pickle
from copy import deepcopy

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, SamplerWithoutReplacement, TensorDictReplayBuffer

from bbq_torchrl.data import BootstrapMask


def rows(*batch, valid=None):
    count = torch.Size(batch).numel()
    td = TensorDict(number=torch.arange(count).reshape(batch), batch_size=batch)
    return td if valid is None else td.set("valid", torch.as_tensor(valid))


def masks(transform, *batch, valid=None):
    return transform.inv(rows(*batch, valid=valid))["bootstrap_mask"]


@pytest.mark.parametrize("prob", [0.5, 0.1, 1.0])
def test_heads_learn_from_their_share_independently(prob):
    n, heads = 20_000, 6
    mask = masks(BootstrapMask(heads, prob), n)
    assert mask.dtype == torch.bool
    assert mask.shape == (n, heads)
    mask = mask.double() - prob
    # means of n numbers with variance p (1 - p); of products of independent ones, its square
    error = prob * (1 - prob) / n**0.5
    assert (mask.mean(0).abs() <= 5.5 * (prob * (1 - prob) / n) ** 0.5).all()
    between_heads = (mask.T @ mask / n).fill_diagonal_(0)
    between_rows = mask[1:].T @ mask[:-1] / n
    for covariance in (between_heads, between_rows):
        assert (covariance.abs() <= 6 * error).all()


@pytest.mark.parametrize("replicas", [(), (1,), (3,), (2, 2)])
def test_masks_have_the_replicas_the_rows_and_the_heads(replicas):
    transform = BootstrapMask(4, replicas=replicas)
    assert masks(transform, *replicas, 7).shape == (*replicas, 7, 4)
    assert masks(transform, *replicas, 7, 3).shape == (*replicas, 7, 3, 4)
    assert masks(transform, *replicas, 0).shape == (*replicas, 0, 4)
    assert masks(transform, *replicas).shape == (*replicas, 4)  # one transition


def test_replicas_have_streams_of_their_own_at_first_from_torchs():
    transform = BootstrapMask(4, replicas=(3,))
    transform.set_seeds([1, 2, 1])
    drawn = masks(transform, 3, 40)
    assert torch.equal(drawn[0], drawn[2])
    assert not torch.equal(drawn[0], drawn[1])
    single = BootstrapMask(4)
    single.set_seeds([2])
    assert torch.equal(masks(single, 40), drawn[1])
    drawn = []
    for seed in (0, 0, 1):
        torch.manual_seed(seed)
        drawn.append(masks(BootstrapMask(4), 40))
    assert torch.equal(drawn[0], drawn[1])
    assert not torch.equal(drawn[0], drawn[2])


def test_masks_do_not_depend_on_padding_calls_or_the_other_elements():
    """The n-th transition that counts gets the n-th draw of its element, whatever is around it."""
    transform = BootstrapMask(5, replicas=(2,))
    transform.set_seeds([3, 4])
    expected = masks(transform, 2, 9)

    transform.set_seeds([3, 4])
    valid = torch.ones(2, 12, dtype=torch.bool)
    valid[0, 4:] = False  # padded at the end
    valid[1, [0, 3, 7]] = False  # or anywhere
    drawn = [masks(transform, 2, 12, valid=valid)]
    assert not drawn[0][~valid].any()
    late = torch.zeros(2, 7, dtype=torch.bool)
    late[0, :5] = True
    drawn.append(masks(transform, 2, 7, valid=late.unsqueeze(-1)))
    assert torch.equal(torch.cat([drawn[0][0, :4], drawn[1][0, :5]]), expected[0])
    assert torch.equal(drawn[0][1, valid[1]], expected[1])


def test_copies_and_states_go_on_with_the_same_numbers():
    transform = BootstrapMask(4, replicas=(2,))
    masks(transform, 2, 5)
    loaded = BootstrapMask(4, replicas=(2,))
    file = io.BytesIO()
    torch.save(transform.state_dict(), file)
    file.seek(0)
    loaded.load_state_dict(torch.load(file, weights_only=True))
    copies = [loaded, deepcopy(transform), pickle.loads(pickle.dumps(transform))]
    expected = masks(transform, 2, 40)
    for copy in copies:
        assert torch.equal(masks(copy, 2, 40), expected)
    assert not torch.equal(masks(transform, 2, 40), expected)


def test_storing_writes_a_copy_where_there_is_no_mask_and_sampling_changes_nothing():
    transform, td = BootstrapMask(4), rows(6)
    assert transform(td) is td
    transform.inv(td)
    assert set(td.keys()) == {"number"}
    state = transform.generator_state.clone()
    td["bootstrap_mask"] = torch.ones(6, 4, dtype=torch.bool)
    assert transform.inv(td)["bootstrap_mask"].all()
    assert torch.equal(transform.generator_state, state)


def test_torchrls_replay_buffer_keeps_each_transitions_mask_under_any_name():
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(100),
        sampler=SamplerWithoutReplacement(),
        transform=BootstrapMask(4, mask_key=("my", "mask"), valid_key=("my", "rows")),
        batch_size=10,
    )
    counts = torch.arange(30) != 3
    buffer.extend(rows(30).set(("my", "rows"), counts))
    buffer.add(TensorDict(number=torch.tensor(30), my={"rows": torch.tensor(True)}))
    masks_stored = buffer[:]["my", "mask"].clone()
    assert masks_stored.shape == (31, 4)
    assert masks_stored.any()
    assert not masks_stored[3].any()
    for _ in range(7):
        batch = buffer.sample()
        assert torch.equal(batch["my", "mask"], masks_stored[batch["number"]])


def test_input_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="heads must be at least 1, got 0"):
        BootstrapMask(0)
    for prob in (0.0, -0.5, 1.5, float("nan")):
        with pytest.raises(ValueError, match=r"prob must be in \(0, 1\], got"):
            BootstrapMask(4, prob)
    transform = BootstrapMask(4, replicas=(3,))
    with pytest.raises(ValueError, match=r"seeds must be 3, one for each replica \[3"):
        transform.set_seeds([1])
    with pytest.raises(
        ValueError, match=r"transitions must have the batch size \[3, \*rows\], got \[2, 5\]"
    ):
        masks(transform, 2, 5)
