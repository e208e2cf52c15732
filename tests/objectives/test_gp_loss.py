"""The closed-form fit of Q next to dynamic programming, and its replicas."""

import pytest
import torch
from q_transitions import ACTIONS, FEATURES, transitions
from tensordict import TensorDict
from torchrl.data import Categorical

from bbq_torchrl.networks import FlatMLP, GaussianProcess, q_actor
from bbq_torchrl.networks.gaussian_process import StateFeatures
from bbq_torchrl.objectives import GPLoss

SPEC = Categorical(ACTIONS)


def gp_loss(replicas=(), **settings):
    features = StateFeatures(FEATURES, 16, replicas=replicas)
    return GPLoss(q_actor(GaussianProcess(features, ACTIONS), SPEC), **settings)


@pytest.mark.parametrize(
    ("noise_std", "prior_std", "value_std"), [(0.02, 10, 6), (1e-8, 2, 6), (1e-15, 1e15, 1e15)]
)
def test_sweeps_are_value_iteration_where_every_state_is_known(noise_std, prior_std, value_std):
    """A chain of states, one-hot: with hardly any noise Q is that of dynamic programming."""
    states, gamma = 6, 0.8
    place, action = (
        part.flatten()
        for part in torch.meshgrid(torch.arange(states), torch.arange(2), indexing="ij")
    )
    after = (place + 2 * action - 1).clamp(0, states - 1)
    reward = torch.randn(states, 2)
    ended = torch.rand(states, 2) < 0.2
    optimal = torch.zeros(states, 2)
    for _ in range(60):
        best = optimal.amax(-1)[after].view(states, 2)
        optimal = reward + gamma * torch.where(ended, 0, best)

    network = GaussianProcess(StateFeatures(states, 12, kernel="rbf"), 2, prior_std=prior_std)
    actor = q_actor(network, Categorical(2), action_mask_key=None)
    loss = GPLoss(actor, noise_std=noise_std, value_std=value_std, sweeps=60, gamma=gamma)
    cells = torch.eye(states)
    result = {"reward": reward.view(-1, 1), "terminated": ended.view(-1, 1)}
    td = TensorDict(
        observation=cells[place],
        action=action,
        next={"observation": cells[after], **result},
        batch_size=[2 * states],
    )
    with torch.autocast("cpu"):
        out = loss.fit(td)

    torch.testing.assert_close(network(cells, "mean").detach(), optimal, rtol=0, atol=0.02)
    assert out["td_error"] < 0.02


def test_a_fit_without_a_solution_leaves_the_other_replicas_alone():
    data, loss, other = transitions(replicas=(2,), batch=(64,)), gp_loss(2), gp_loss(2)
    other.load_state_dict(loss.state_dict())
    plain = other.fit(data)
    data["observation"][0, 3] = torch.inf
    out = loss.fit(data)
    assert out["loss_value"].isnan().tolist() == [True, False]
    assert torch.equal(loss.network.mean[1:], other.network.mean[1:])
    assert torch.equal(out["loss_value"][1:], plain["loss_value"][1:])


@pytest.mark.parametrize("target", ["mean", "draw"])
def test_a_replica_is_fitted_bitwise_as_next_to_others_and_padding_is_left_out(target):
    loss, data = gp_loss((3,), target=target), transitions((3,), (50,))
    start = {name: value.clone() for name, value in loss.state_dict().items()}
    data["valid"] = torch.ones(3, 50).bool()
    torch.manual_seed(0)
    loss.fit(data)
    mean, factor = loss.network.mean[0].clone(), loss.network.factor[0].clone()

    loss.load_state_dict(start)
    others = torch.cat([data, transitions((3,), (20,)).set("valid", torch.zeros(3, 20).bool())], 1)
    others[1:] = transitions((2,), (70,)).set("valid", torch.rand(2, 70) < 0.8)
    others["observation"][0, 50:] = torch.nan
    torch.manual_seed(0)
    out = loss.fit(others)

    assert torch.equal(loss.network.mean[0], mean)
    assert torch.equal(loss.network.factor[0], factor)
    assert out["loss_value"].isfinite().all()


@pytest.mark.parametrize(
    "settings", [{"noise_std": 0.0}, {"value_std": -1.0}, {"sweeps": 0}, {"target": "max"}]
)
def test_invalid_settings_and_another_network_are_refused(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        gp_loss(**settings)
    with pytest.raises(ValueError, match="GaussianProcess"):
        GPLoss(q_actor(FlatMLP(FEATURES, ACTIONS), SPEC))
