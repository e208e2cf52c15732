"""What BBQN learns: inactive weights stay, data narrow the posterior, a bandit is solved."""

from __future__ import annotations

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
