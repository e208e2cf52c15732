"""What BBQN learns: inactive weights stay, data narrow the posterior, a bandit is solved."""

from __future__ import annotations

import pytest
import torch
from q_transitions import flat, transitions
from torchrl.data import Categorical
from torchrl.objectives import HardUpdate

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.networks import q_actor
from bbq_torchrl.objectives import BBQNLoss


def test_inactive_weights_stay_bitwise_at_the_prior_under_adam():
    # features and actions that are masked, hundreds of steps, every parameter under Adam; the
    # sizes leave remainders in every vectorized loop
    for replicas in [(), (2,)]:
        net = BayesMLP(11, 7, (13,), replicas=replicas, prior_std=0.1)
        start = {k: v.clone() for k, v in net.state_dict().items()}
        loss = BBQNLoss(q_actor(net, Categorical(7)), num_data=50)
        update = HardUpdate(loss, value_network_update_interval=0)
        optimizer = torch.optim.Adam(loss.parameters(), 1e-2)
        mask = torch.tensor([True, False, True, True, False, True, False])
        features = torch.rand(11) < 0.6
        features[0], features[-1] = True, False
        for step in range(300):
            shape = (*replicas, 16)
            observation = torch.randn(*shape, 11) * features
            action = torch.tensor([0, 2, 3, 5])[torch.randint(4, shape)]
            state = {"observation": observation, "action_mask": mask.expand(*shape, 7)}
            td = transitions(replicas, (16,))
            td.update({**state, "action": action})
            td["next"] = {**td["next"].to_dict(), **state}
            optimizer.zero_grad()
            loss(td)["loss"].backward()
            optimizer.step()
            if step % 50 == 0:
                update.step()
        for name in ("mu", "rho"):
            now = net.layout.unflatten(flat(loss, name).detach())
            then = net.layout.unflatten(start[f"posterior.{name}"])
            (first, _), (last, last_bias) = now
            (first_then, _), (last_then, last_bias_then) = then
            assert torch.equal(first[..., ~features, :], first_then[..., ~features, :])
            assert torch.equal(last[..., ~mask], last_then[..., ~mask])
            assert torch.equal(last_bias[..., ~mask], last_bias_then[..., ~mask])
            assert (first[..., features, :] != first_then[..., features, :]).all()
            assert (last[..., mask] != last_then[..., mask]).all()


def test_the_sampled_kl_moves_weights_that_no_data_reach():
    # why the closed form is the default
    net = BayesMLP(3, 2, ())
    loss = BBQNLoss(q_actor(net, Categorical(2), action_mask_key=None), kl="sampled", num_data=50)
    HardUpdate(loss, value_network_update_interval=0)
    optimizer = torch.optim.Adam(loss.parameters(), 1e-3)
    td = transitions()
    zeros = torch.zeros(32, 3)
    td["observation"], td["next", "observation"] = zeros, zeros
    td["action"] = torch.zeros(32, dtype=torch.int64)
    for _ in range(20):
        optimizer.zero_grad()
        loss(td)["loss"].backward()
        optimizer.step()
    assert (net.layout.unflatten(flat(loss, "mu"))[0][0] != 0).all()


def exact_posterior(x, y, noise_std, prior_std):
    """Mean and std of each weight for y = w · x + noise with orthogonal columns of x."""
    precision = x.square().sum(0) / noise_std**2 + 1 / prior_std**2
    return (x * y.unsqueeze(-1)).sum(0) / noise_std**2 / precision, precision**-0.5


def test_more_data_narrow_the_posterior_as_bayes_rule_says():
    # Linear regression with orthogonal features: the exact posterior is a factorized Gaussian.
    # One network learns from 24 rows, one from three copies of them: duplicating the data set
    # must have the effect of more data.
    signs = torch.tensor([[1.0, 1.0], [1.0, -1.0]], dtype=torch.double)
    hadamard = torch.kron(signs, torch.kron(signs, signs)).repeat(3, 1)
    # three features that differ, one that is always 0, and the bias' constant
    design = torch.stack([*hadamard.T[1:4], torch.zeros(24), hadamard.T[0]], 1)
    y = design @ torch.tensor([0.5, -0.3, 0.2, 0.0, 0.4]).double() + 0.1 * torch.randn(24)
    noise_std, prior_std = 0.5, 0.3
    net = BayesMLP(4, 1, (), replicas=(2,), prior_std=prior_std, dtype=torch.double)
    loss = BBQNLoss(
        q_actor(net, Categorical(1), action_mask_key=None),
        noise_std=noise_std,
        num_data=torch.tensor([24, 72]),
    )
    HardUpdate(loss, value_network_update_interval=0)
    td = transitions((2,), (72,), dtype=torch.double)
    td["observation"] = design.repeat(3, 1)[:, :4].expand(2, 72, 4)
    td["next", "observation"] = td["observation"]
    td["action"].zero_()
    td["next", "reward"][:] = y.repeat(3).unsqueeze(-1)
    td["next", "terminated"].fill_(True)
    td["valid"] = torch.arange(72) < torch.tensor([[24], [72]])
    optimizer = torch.optim.Adam(loss.parameters(), 5e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 800)
    for _ in range(800):
        optimizer.zero_grad()
        loss(td)["loss"].backward()
        optimizer.step()
        schedule.step()
    sigma = torch.nn.functional.softplus(flat(loss, "rho")).detach()
    for k, copies in enumerate((1, 3)):
        mean, std = exact_posterior(
            design.repeat(copies, 1), y.repeat(copies), noise_std, prior_std
        )
        # one draw a step leaves the optimum by a few per cent; three copies narrow it by 1.7
        torch.testing.assert_close(sigma[k], std, rtol=0.2, atol=0)
        torch.testing.assert_close(
            flat(loss, "mu").detach()[k], mean, rtol=0, atol=0.5 * float(std.min())
        )
        # the weight of the feature that is always 0 is still the prior's
        assert sigma[k, 3] == pytest.approx(prior_std)


def test_thompson_sampling_with_bbqn_solves_a_bandit():
    # Two-armed, arm 1 pays more; the posterior must come to prefer it and be surer of what was
    # tried. Arms are tried by Thompson sampling on the posterior itself.
    torch.manual_seed(0)
    net = BayesMLP(1, 2, (), prior_std=1.0)
    loss = BBQNLoss(q_actor(net, Categorical(2), action_mask_key=None), noise_std=0.5, gamma=0.0)
    HardUpdate(loss, value_network_update_interval=0)
    optimizer = torch.optim.Adam(loss.parameters(), 0.05)
    x, pays = torch.ones(1, 1), torch.tensor([0.0, 1.0])
    actions, rewards = [], []
    for pull in range(40):
        action = int(net(x, "draw").argmax())
        actions.append(action)
        rewards.append(float(pays[action] + 0.5 * torch.randn(())))
        n = pull + 1
        td = transitions(batch=(n,))
        td["observation"] = td["next", "observation"] = torch.ones(n, 1)
        td["action"] = torch.tensor(actions)
        td["next", "reward"] = torch.tensor(rewards).unsqueeze(-1)
        loss.set_num_data(n)
        for _ in range(6):
            optimizer.zero_grad()
            loss(td)["loss"].backward()
            optimizer.step()
    assert sum(actions[-15:]) >= 11
    q = net(x, "mean")[0]
    assert q[1] - q[0] > 0.3
