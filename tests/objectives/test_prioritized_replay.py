"""The losses with TorchRL's prioritized replay buffer, whose sampler is in its C++ extension."""

from __future__ import annotations

import pytest
import torch
from q_transitions import plain_loss, transitions
from tensordict import TensorDict
from torchrl.data import Categorical, LazyTensorStorage, TensorDictPrioritizedReplayBuffer
from torchrl.objectives import HardUpdate

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.networks import BootstrapMLP, FlatMLP, bootstrap_actor, q_actor
from bbq_torchrl.objectives import BBQNLoss, BootstrapDQNLoss, DropoutDQNLoss

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


def test_the_weighted_mean_of_what_is_drawn_is_that_of_the_buffer(buffer):
    """With β = 1 the weights undo the sampling: the mean loss is that of all rows once."""
    loss, rows = plain_loss()[0], transitions()
    with torch.no_grad():
        whole = loss(rows)["loss_value"]
        replay = buffer(rows, batch_size=100_000)
        replay.sampler.beta = 1.0
        replay.update_priority(torch.arange(len(rows)), rows["td_error"].squeeze(-1))
        drawn = replay.sample()
        torch.testing.assert_close(loss(drawn)["loss_value"], whole, rtol=0.03, atol=0)
        loss.use_prioritized_weights = False
        assert loss(drawn)["loss_value"] > 1.3 * whole


SPEC = Categorical(2)
LOSSES = {
    "bbqn": lambda: BBQNLoss(
        q_actor(BayesMLP(STATES, 2, (32,), std_init=0.03, mean_init="kaiming"), SPEC),
        noise_std=0.3,
        kl_temperature=0.1,
        num_data=STATES * COPIES,
    ),
    "dqn": lambda: DropoutDQNLoss(q_actor(FlatMLP(STATES, 2, (32,), dropout=0.0), SPEC)),
    "bootstrap": lambda: BootstrapDQNLoss(
        bootstrap_actor(BootstrapMLP(STATES, 2, (32,), heads=3), SPEC)
    ),
}


@pytest.mark.parametrize("kind", LOSSES)
def test_a_rare_reward_is_learned_from_a_prioritized_buffer(kind, buffer):
    rows, loss = corridor(), LOSSES[kind]()
    replay, freeze = buffer(rows), HardUpdate(loss, value_network_update_interval=0)
    optimizer = torch.optim.Adam(loss.parameters(), 3e-3)
    ends = 0
    for step in range(STEPS):
        batch = replay.sample()
        ends += int(batch["next", "terminated"].sum())
        loss(batch)["loss"].backward()
        optimizer.step()
        optimizer.zero_grad()
        replay.update_tensordict_priority(batch)
        if step % 20 == 19:
            freeze.step()
    assert ends > 4 * STEPS * 32 * rows["next", "terminated"].float().mean()
    states = torch.eye(STATES)
    seen = TensorDict(observation=states, action_mask=torch.ones(STATES, 2).bool(), batch_size=[4])
    with torch.no_grad():
        values = loss.value_network(seen)["action_value"]
    assert values.reshape(STATES, -1, 2).mean(1).argmax(-1).tolist() == [1] * STATES


def corridor():
    """Steps in a corridor: action 1 moves ahead, 0 to the start; one row has the rewarded end."""
    at = torch.arange(STATES).repeat_interleave(2).repeat(COPIES)
    action = torch.tensor([0, 1]).repeat(STATES * COPIES)
    end = (at == STATES - 1) & (action == 1)
    keep = ~end | (end.cumsum(0) == 1)
    at, action, end = at[keep], action[keep], end[keep].unsqueeze(-1)
    to = torch.where(action == 1, (at + 1).clamp(max=STATES - 1), 0)
    mask = torch.ones(len(at), 2, dtype=torch.bool)
    following = {"observation": torch.eye(STATES)[to], "action_mask": mask}
    reward = end.float()
    return TensorDict(
        {
            "observation": torch.eye(STATES)[at],
            "action_mask": mask,
            "action": action,
            "next": {**following, "reward": reward, "done": end, "terminated": end.clone()},
        },
        [len(at)],
    )
