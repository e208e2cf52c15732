"""TorchRL's conventions for losses: keys, dispatch, functional parameters, copies."""

import pytest
import torch
from q_transitions import COPIES, result, transitions
from torchrl.data import MultiStep
from torchrl.objectives.utils import ValueEstimators


def test_parameters_are_the_networks_once_and_targets_are_none(make):
    loss = make((2,))
    expected = [id(p) for p in loss.value_network.parameters()]
    assert sorted(map(id, loss.parameters())) == sorted(expected)
    assert all(p.requires_grad for p in loss.parameters())
    assert not any(p.requires_grad for p in loss.target_value_network_params.values(True, True))


@pytest.mark.parametrize("replicas", [(), (3,)], ids=str)
def test_it_reads_and_returns_what_its_keys_say(make, replicas):
    loss, td = make(replicas), transitions(replicas)
    assert set(loss.in_keys) == {
        "observation",
        "action_mask",
        "action",
        *(("next", k) for k in ("observation", "action_mask", "reward", "done", "terminated")),
    }
    out = loss(td)
    assert out.batch_size == ()
    for key, value in out.items():
        assert value.shape == (() if key == "loss" else replicas)
        assert value.requires_grad == (key == "loss")
    added = [["kl"], []]
    assert loss.out_keys in [["loss", "loss_value", "td_error", "q_value", *a] for a in added]
    assert set(out.keys()) == set(loss.out_keys)
    assert td["td_error"].shape == (*replicas, 32, 1)


def test_it_can_be_called_with_tensors(make):
    loss, td = make(), transitions()
    expected = result(loss, td.clone())
    torch.manual_seed(0)
    found = loss(**dict(td.flatten_keys("_").items()))
    torch.testing.assert_close(list(found), [expected[key] for key in loss.out_keys])


def test_keys_can_be_set(make):
    loss, td = make(), transitions()
    expected = result(loss, td.clone())["loss"]
    td["deep", "act"] = td.pop("action")
    td["next", "pay"] = td["next"].pop("reward")
    td["next", "over"] = td["next"].pop("terminated")
    loss.set_keys(action=("deep", "act"), reward="pay", terminated="over", priority="how_wrong")
    assert {("deep", "act"), ("next", "pay"), ("next", "over")} <= set(loss.in_keys)
    assert torch.equal(result(loss, td)["loss"], expected)
    assert td.get("how_wrong") is not None


def test_gamma_is_the_value_estimators(make):
    loss, other, td = make(gamma=0.9), make(gamma=0.3), transitions()
    state = {k: v for k, v in loss.state_dict().items() if "gamma" not in k}
    other.load_state_dict(state, strict=False)
    assert loss.value_estimator.gamma == pytest.approx(0.9)
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.3)
    torch.testing.assert_close(result(loss, td), result(other, td))
    for kind in (ValueEstimators.TD1, ValueEstimators.TDLambda):
        with pytest.raises(NotImplementedError, match="Supported value types"):
            loss.make_value_estimator(kind)
    loss.make_value_estimator(ValueEstimators.TD0, average_rewards=True)
    with pytest.raises(ValueError, match="average_rewards of the value estimator must be False"):
        loss(td)


@pytest.mark.parametrize("gamma", [0.5, torch.tensor([0.1, 0.5, 0.9, 1.0])], ids=["one", "each"])
def test_the_discount_of_n_step_data_is_that_of_n_steps(make, gamma):
    loss = make((4,), gamma=gamma)
    td = MultiStep(gamma=0.5, n_steps=3)(transitions((4,), (8,)))
    assert td["steps_to_next_obs"].unique().numel() > 1
    value = torch.randn(4, 8, 1)
    discount = torch.as_tensor(gamma).reshape(-1, 1, 1) ** td["steps_to_next_obs"].unsqueeze(-1)
    # the target of this data is the reward of that
    target = td.exclude("steps_to_next_obs").clone()
    target["next", "reward"] = td["next", "reward"] + discount * value * ~td["next", "terminated"]
    target["next", "terminated"] = torch.ones(4, 8, 1).bool()
    has_heads = "bootstrap_mask" in vars(loss.tensor_keys)
    td["next", "next_state_value"] = value.unsqueeze(-2).expand(4, 8, 3, 1) if has_heads else value
    torch.testing.assert_close(result(loss, td), result(loss, target))


@pytest.mark.parametrize("way", COPIES)
def test_a_copy_is_the_same_loss_with_separate_parameters(make, way):
    loss, other, td = make((2,)), make((2,)), transitions((2,))
    expected = result(loss, td)["loss"]
    result(other, td)  # what it may have kept of its own parameters is not used any more
    copy = COPIES[way](loss, other)
    assert torch.equal(result(copy, td)["loss"], expected)
    with torch.no_grad():
        for parameter in copy.parameters():
            parameter.add_(1.0)
    assert not torch.equal(result(copy, td)["loss"], expected)
    assert way == "assigned" or torch.equal(result(loss, td)["loss"], expected)


def test_the_dtype_can_change(make):
    loss, td = make((2,)), transitions((2,))
    loss(td.clone())
    loss.double()
    out = loss(td.apply(lambda t: t.double() if t.is_floating_point() else t))
    out["loss"].backward()
    assert out["loss"].dtype == torch.double
    assert all(p.grad.dtype == torch.double for p in loss.parameters())


def test_parameters_can_be_reset(make):
    loss = make((2,))
    before = [p.detach().clone() for p in loss.parameters()]
    loss.reset_parameters_recursive()
    assert not any(map(torch.equal, loss.parameters(), before))
