"""VIMELoss is the two losses that it runs, for optimizers, target updaters and states."""

from __future__ import annotations

import pickle
from copy import deepcopy

import pytest
import torch
from dynamics_losses import dynamics_loss, result
from q_transitions import ACTIONS, FEATURES, bayes_loss, plain_loss, transitions
from torchrl.data import Categorical
from torchrl.objectives import DiscreteCQLLoss, HardUpdate, SoftUpdate

from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import DropoutDQNLoss
from bbq_torchrl.vime import VIMELoss

MAKERS = {
    "dqn": (
        lambda replicas, **s: plain_loss(replicas, dropout=0.5, **s)[0],
        ["td_error", "q_value"],
    ),
    "bbqn": (lambda replicas, **s: bayes_loss(replicas, **s)[0], ["td_error", "q_value", "kl"]),
}


@pytest.fixture(params=list(MAKERS))
def kind(request):
    return request.param


def vime_loss(kind="dqn", replicas=(), **settings):
    """Both losses, not yet known to any target updater."""
    return VIMELoss(MAKERS[kind][0](replicas), dynamics_loss(replicas), **settings)


@pytest.mark.parametrize("replicas", [(), (3,)])
def test_it_returns_what_both_return_and_the_sum(kind, replicas):
    loss = vime_loss(kind, replicas)
    td = transitions(replicas)
    torch.manual_seed(0)
    q, dynamics = loss.q_loss(td.clone()), loss.dynamics_loss(td.clone())
    out = result(loss, td)
    assert set(out.keys()) == set(loss.out_keys)
    assert set(out.keys()) == {
        "loss",
        "loss_value",
        "dynamics_loss",
        "dynamics_kl",
        *MAKERS[kind][1],
    }
    torch.testing.assert_close(out["loss"], q["loss"] + dynamics["loss"])
    for key, value in out.items():
        assert value.requires_grad == (key == "loss")
        if key != "loss":
            assert torch.equal(value, q.get(key, dynamics.get(key, None)))
    assert td["td_error"].shape == (*replicas, 32, 1)


def test_parameters_and_states_hold_everything_once(kind):
    loss = vime_loss(kind, (2,))
    parameters = list(loss.parameters())
    assert len({id(p) for p in parameters}) == len(parameters)
    parts = [*loss.q_loss.parameters(), *loss.dynamics_loss.parameters()]
    assert {id(p) for p in parameters} == {id(p) for p in parts}
    state = loss.state_dict()
    own = len(loss.q_loss.state_dict()) + len(loss.dynamics_loss.state_dict())
    assert len(state) == own + 2  # what is held, and the count


def targets(loss):
    return {k: v.clone() for k, v in loss.q_loss.state_dict().items() if k.startswith("target_")}


def test_torchrls_target_updaters_find_the_q_losss_targets():
    q_loss = DropoutDQNLoss(q_actor(FlatMLP(FEATURES, ACTIONS), Categorical(ACTIONS)))
    loss = VIMELoss(q_loss, dynamics_loss())
    td = transitions()
    with pytest.warns(UserWarning, match="No target network updater"):
        loss(td)
    update = HardUpdate(loss, value_network_update_interval=0)
    loss(td)  # warns no more
    with torch.no_grad():
        for parameter in q_loss.parameters():
            parameter.add_(1.0)
    before = targets(loss)
    update.step()
    source = q_loss.state_dict()
    for key, value in targets(loss).items():
        assert torch.equal(value, source[key.removeprefix("target_")])
        assert not torch.equal(value, before[key])
    SoftUpdate(vime_loss(), tau=0.5).step()


def test_the_rest_is_the_q_losss(kind):
    loss = vime_loss(kind, (2,))
    assert loss.value_network is loss.q_loss.value_network
    assert loss.replicas == (2,)
    assert loss.tensor_keys.priority == "td_error"
    assert set(loss.in_keys) == {*loss.q_loss.in_keys, *loss.dynamics_loss.in_keys}
    loss.make_value_estimator(gamma=0.25)
    assert loss.q_loss.value_estimator.gamma == pytest.approx(0.25)
    loss.set_num_data(torch.tensor([3, 4]))
    for part in (loss.dynamics_loss, *([loss.q_loss] if kind == "bbqn" else [])):
        assert part.num_data.tolist() == [3, 4]
    with pytest.raises(AttributeError, match="nothing_of_this_name"):
        _ = loss.nothing_of_this_name


def test_keys_reach_the_losses_that_have_them():
    loss = vime_loss()
    td = transitions()
    expected = result(loss, td)["loss"]
    td["next", "pay"] = td["next"].pop("reward")
    td["next", "over"] = td["next"].pop("terminated")
    td["act"] = td.pop("action")
    loss.set_keys(reward="pay", terminated="over", action="act")
    assert torch.equal(result(loss, td)["loss"], expected)
    assert loss.dynamics_loss.tensor_keys.terminated == "over"
    with pytest.raises(ValueError, match="rewards is not an accepted tensordict key"):
        loss.set_keys(rewards="x")


def test_the_mask_reaches_both():
    loss = vime_loss()
    td = transitions()
    td["valid"] = torch.rand(32) < 0.5
    expected = result(loss, td)["loss"]
    td["counts"] = td.pop("valid")
    loss.loss_mask_key = "counts"
    assert loss.loss_mask_key == "counts"
    assert torch.equal(result(loss, td)["loss"], expected)


def test_the_dynamics_may_learn_on_every_kth_batch_only():
    loss = vime_loss(replicas=(2,), dynamics_every=3)
    learned, reported = [], []
    for _ in range(7):
        loss.zero_grad()
        out = loss(transitions((2,)))
        out["loss"].backward()
        learned.append(loss.dynamics_loss.dynamics.network.posterior.mu.grad is not None)
        reported.append(out["dynamics_loss"])
        assert all(p.grad is not None for p in loss.q_loss.parameters())
    assert learned == [True, False, False, True, False, False, True]
    assert torch.equal(reported[0], reported[2])
    assert not torch.equal(reported[2], reported[3])
    assert torch.equal(reported[3], reported[5])
    loss.begin_epoch()
    loss.zero_grad()
    loss(transitions((2,)))["loss"].backward()
    assert loss.dynamics_loss.dynamics.network.posterior.mu.grad is not None


@pytest.mark.parametrize("copy", ["state", "deepcopy", "pickle"])
def test_it_goes_on_where_it_was(copy):
    loss = vime_loss(replicas=(2,), dynamics_every=3)
    batches = [transitions((2,)) for _ in range(5)]
    result(loss, batches[0])
    result(loss, batches[1])
    if copy == "state":
        other = vime_loss(replicas=(2,), dynamics_every=3)
        other.load_state_dict(loss.state_dict())
    else:
        other = deepcopy(loss) if copy == "deepcopy" else pickle.loads(pickle.dumps(loss))
    for td in batches[2:]:
        ours, theirs = result(loss, td), result(other, td)
        for key, value in ours.items():
            assert torch.equal(theirs[key], value)


def test_bad_parts_are_named():
    with pytest.raises(ValueError, match="dynamics_every must be at least 1, got 0"):
        vime_loss(dynamics_every=0)
    part = dynamics_loss()
    with pytest.raises(ValueError, match="must not have parameters in common"):
        VIMELoss(part, part)


def test_a_loss_in_parts_is_refused():
    actor = q_actor(torch.nn.Linear(FEATURES, ACTIONS), Categorical(ACTIONS), action_mask_key=None)
    loss = VIMELoss(DiscreteCQLLoss(actor), dynamics_loss())
    HardUpdate(loss, value_network_update_interval=0)
    with pytest.raises(KeyError, match=r'key "loss" not found in TensorDict with keys .*loss_cql'):
        loss(transitions())
