"""What TorchRL expects of a loss: keys, dispatch, functional parameters, target updates."""

from __future__ import annotations

import pickle
from copy import deepcopy
from typing import TYPE_CHECKING, NamedTuple

import pytest
import torch
from q_transitions import (
    FEATURES,
    bayes_loss,
    flat,
    heads_loss,
    noisy_loss,
    plain_loss,
    transitions,
)
from torchrl.data import MultiStep
from torchrl.objectives.utils import ValueEstimators

if TYPE_CHECKING:
    from collections.abc import Callable

OUT_KEYS = ["loss", "loss_value", "td_error", "q_value"]


class Case(NamedTuple):
    """What makes a loss and its update, and the names of its parameters."""

    make: Callable
    names: tuple[str, ...]
    out_keys: list[str] = OUT_KEYS


LOSSES = {
    "bbqn": Case(bayes_loss, ("mu", "rho"), [*OUT_KEYS, "kl"]),
    "dqn": Case(plain_loss, ("weight",)),
    "bootstrap": Case(heads_loss, ("trunk", "heads")),
    "noisy": Case(noisy_loss, ("weight_mu", "weight_sigma", "bias_mu", "bias_sigma")),
}


@pytest.fixture(params=list(LOSSES))
def case(request):
    return LOSSES[request.param]


def result(loss, td):
    torch.manual_seed(0)
    return loss(td)["loss"]


def test_parameters_are_the_online_networks_and_targets_are_buffers(case):
    loss, _ = case.make((2,))
    trainable = {name.rsplit(".", 1)[-1] for name, _ in loss.named_parameters()}
    assert trainable == set(case.names)
    assert all(p.requires_grad for p in loss.parameters())
    network = {id(p) for p in loss.value_network.parameters()}
    assert {id(p) for p in loss.parameters()} == network
    for name in case.names:
        assert not flat(loss, name, target=True).requires_grad


def test_in_and_out_keys(case):
    loss, _ = case.make()
    assert set(loss.in_keys) == {
        "observation",
        "action_mask",
        "action",
        *(("next", k) for k in ("observation", "action_mask", "reward", "done", "terminated")),
    }
    assert loss.out_keys == case.out_keys
    assert set(loss(transitions()).keys()) == set(case.out_keys)
    assert list(loss.select_out_keys("loss")(transitions()).keys()) == ["loss"]


@pytest.mark.parametrize("replicas", [(), (3,)])
def test_only_the_scalar_loss_has_a_graph(case, replicas):
    loss, _ = case.make(replicas)
    out = loss(transitions(replicas))
    assert out.batch_size == ()
    for key in case.out_keys:
        assert out[key].shape == (() if key == "loss" else replicas)
        assert out[key].requires_grad == (key == "loss")


def test_it_can_be_called_with_tensors(case):
    loss, _ = case.make()
    td = transitions()
    flat_td = td.flatten_keys("_")
    torch.manual_seed(0)
    out = loss(**dict(flat_td.items()))
    torch.testing.assert_close(out[case.out_keys.index("loss")], result(loss, td))


def test_keys_can_be_set(case):
    loss, _ = case.make()
    td = transitions()
    expected = result(loss, td)
    moved = td.exclude("td_error")
    moved["deep", "act"] = moved.pop("action")
    moved["next", "pay"] = moved["next"].pop("reward")
    moved["next", "over"] = moved["next"].pop("terminated")
    loss.set_keys(action=("deep", "act"), reward="pay", terminated="over", priority="how_wrong")
    assert {("deep", "act"), ("next", "pay"), ("next", "over")} <= set(loss.in_keys)
    assert torch.equal(result(loss, moved), expected)
    assert moved.get("how_wrong") is not None


def test_gamma_is_the_value_estimators(case):
    loss, _ = case.make(gamma=0.9)
    td = transitions()
    other, _ = case.make(gamma=0.3)
    state = {k: v for k, v in loss.state_dict().items() if "gamma" not in k}
    other.load_state_dict(state, strict=False)
    expected = result(other, td)
    assert loss.value_estimator.gamma == pytest.approx(0.9)
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.3)
    torch.testing.assert_close(result(loss, td), expected)
    for other in (ValueEstimators.TD1, ValueEstimators.TDLambda):
        with pytest.raises(NotImplementedError, match="Supported value types"):
            loss.make_value_estimator(other)


def test_targets_of_n_step_data_are_torchrls(case):
    loss, _ = case.make(gamma=0.5)
    td = MultiStep(gamma=0.5, n_steps=3)(transitions((4,), (8,)))
    assert td["steps_to_next_obs"].unique().numel() > 1
    value = torch.randn(4, 8, 1)
    td["next", "next_state_value"] = loss._beside_values(value)
    expected = loss.value_estimator.value_estimate(td, next_value=value)
    target = loss._td_target(td, *loss._tensors()).reshape(expected.shape)
    torch.testing.assert_close(target, expected)


def test_the_discount_of_n_step_data_may_differ_between_replicas(case):
    loss, _ = case.make((2,), gamma=torch.tensor([0.5, 0.9]))
    td = transitions((2,))
    td["steps_to_next_obs"] = torch.full((2, 32), 2)
    found = result(loss, td)
    loss.make_value_estimator(ValueEstimators.TD0, gamma=[0.25, 0.81])
    torch.testing.assert_close(found, result(loss, td.exclude("steps_to_next_obs")))


def test_average_rewards_are_refused(case):
    loss, _ = case.make()
    loss.make_value_estimator(ValueEstimators.TD0, average_rewards=True)
    with pytest.raises(ValueError, match="average_rewards of the value estimator must be False"):
        loss(transitions())


@pytest.mark.parametrize("assign", [False, True])
def test_states_round_trip(case, assign):
    loss, other = case.make((2,))[0], case.make((2,))[0]
    td = transitions((2,))
    result(other, td)
    other.load_state_dict(loss.state_dict(), assign=assign)
    assert torch.equal(result(other, td), result(loss, td))


def test_copies_are_independent(case):
    loss, _ = case.make()
    td = transitions()
    expected = result(loss, td)
    for copy in (deepcopy(loss), pickle.loads(pickle.dumps(loss))):
        assert torch.equal(result(copy, td), expected)
        with torch.no_grad():
            for parameter in copy.parameters():
                parameter.add_(1.0)
        assert not torch.equal(result(copy, td), expected)
        assert torch.equal(result(loss, td), expected)


def test_the_dtype_can_change(case):
    loss, _ = case.make((2,))
    td = transitions((2,))
    loss(td)
    loss.double()
    double = td.exclude("td_error").apply(lambda t: t.double() if t.is_floating_point() else t)
    out = loss(double)
    out["loss"].backward()
    assert out["loss"].dtype == torch.double
    for name in case.names:
        assert flat(loss, name).grad.dtype == torch.double


def test_parameters_can_be_reset(case):
    loss, _ = case.make((2,))
    before = {n: flat(loss, n).detach().clone() for n in case.names}
    loss.reset_parameters_recursive()
    for n in case.names:
        assert not torch.equal(flat(loss, n), before[n])


def test_a_failing_network_leaves_its_parameters_in_place(case):
    loss, _ = case.make()
    td = transitions()
    td["next", "observation"] = torch.randn(32, FEATURES + 1)
    own = list(loss.value_network.parameters())
    with pytest.raises(ValueError, match="input must have shape"):
        loss(td)
    assert all(a is b for a, b in zip(loss.value_network.parameters(), own, strict=True))
    result(loss, transitions())


def test_a_missing_mask_is_an_error_and_not_that_all_is_legal(case):
    loss, _ = case.make()
    td = transitions()
    del td["next"]["action_mask"]
    with pytest.raises(KeyError, match=r"'next', 'action_mask'.* is missing.*action_mask_key=None"):
        loss(td)


@pytest.mark.parametrize("key", ["action", "observation", ("next", "terminated")])
def test_a_missing_entry_is_named(case, key):
    loss, _ = case.make()
    name = key if isinstance(key, str) else key[-1]
    with pytest.raises(KeyError, match=f'key "{name}" not found'):
        loss(transitions().exclude(key))


@pytest.mark.parametrize("key", ["reward", "terminated"])
def test_a_reward_or_end_without_its_last_dimension_is_refused(case, key):
    loss, _ = case.make((2,))
    td = transitions((2,))
    td["valid"] = torch.ones(2, 32).bool()
    td["next", key] = td["next", key].squeeze(-1)
    with pytest.raises(
        ValueError, match=r"'reward' and 'terminated' must have shape \[\*batch, 1\], got .*32\]"
    ):
        loss(td)


def test_actions_of_the_other_action_space_are_refused(case):
    loss, _ = case.make()
    td = transitions()
    one_hot = td.clone().set("action", torch.nn.functional.one_hot(td["action"], 4))
    with pytest.raises(ValueError, match=r"'action' must be categorical with batch \[32\]"):
        loss(one_hot)
    expected = result(loss, td)
    loss.action_space = "one_hot"
    with pytest.raises(ValueError, match=r"'action' must be one_hot with batch \[32\], .* \[32\]"):
        loss(td)
    assert torch.equal(result(loss, one_hot), expected)


@pytest.mark.parametrize(("mask", "shape"), [("valid", (32,)), ("bootstrap_mask", (32, 3))])
def test_rewards_may_be_whole_numbers(case, mask, shape):
    loss, _ = case.make()
    td = transitions()
    td[mask] = torch.rand(shape) < 0.6
    td["next", "reward"] = td["next", "reward"].round()
    expected = result(loss, td)
    td["next", "reward"] = td["next", "reward"].long()
    assert torch.equal(result(loss, td), expected)


def test_ends_may_be_numbers(case):
    loss, _ = case.make()
    td = transitions()
    expected = result(loss, td)
    td["next", "terminated"] = td["next", "terminated"].to(torch.uint8)
    assert torch.equal(result(loss, td), expected)


def everything(loss, td):
    """What a loss returns and writes, and its gradients."""
    torch.manual_seed(1)
    out = loss(td)
    gradients = torch.autograd.grad(out["loss"], list(loss.parameters()))
    return [*out.detach().exclude("loss").values(), td["td_error"], *gradients]


@pytest.mark.parametrize("entry", ["observation", ("next", "observation"), ("next", "reward")])
def test_rows_that_do_not_count_change_nothing_whatever_they_hold(case, entry):
    loss, _ = case.make((2,), dtype=torch.double)
    td = transitions((2,), (6,), dtype=torch.double)
    td["valid"] = torch.arange(6).expand(2, 6) < 4
    spoilt = td.clone()
    spoilt[entry][:, 4:] = torch.nan
    *outputs, errors = found = everything(loss, td)[: len(loss.out_keys)]
    torch.testing.assert_close(everything(loss, spoilt), everything(loss, td), rtol=0, atol=0)
    assert not errors[:, 4:].any()
    short = everything(loss, td[:, :4].exclude("valid", "td_error"))
    torch.testing.assert_close(outputs, short[: len(found) - 1])


def test_a_replica_without_rows_has_no_loss_and_no_gradient(case):
    loss, _ = case.make((2,), **({"kl_temperature": 0.0} if case.make is bayes_loss else {}))
    td = transitions((2,))
    td["valid"] = torch.tensor([[False] * 32, [True] * 32])
    out = loss(td)
    out["loss"].backward()
    for key in ("loss_value", "td_error", "q_value"):
        assert out[key][0] == 0
        assert out[key][1] != 0
    for name in case.names:
        assert not flat(loss, name).grad[0].any()
        assert flat(loss, name).grad[1].any()


@pytest.mark.parametrize("replicas", [(), (2,)])
def test_a_batch_without_rows_has_no_loss_and_no_gradient(case, replicas):
    loss, _ = case.make(replicas, **({"kl_temperature": 0.0} if case.make is bayes_loss else {}))
    td = transitions(replicas, (0,))
    out = loss(td)
    out["loss"].backward()
    for key in ("loss", "loss_value", "td_error", "q_value"):
        assert not out[key].any()
    assert not any(flat(loss, name).grad.any() for name in case.names)
    assert td["td_error"].shape == (*replicas, 0, 1)


@pytest.mark.parametrize("where", ["next", "root"])
def test_what_one_replica_sees_leaves_the_others_bits_alone(case, where):
    def seen(spoil):
        torch.manual_seed(0)
        loss, _ = case.make((3,), hidden=(33, 17))
        td = transitions((3,))
        if spoil:
            (td if where == "root" else td["next"])["observation"][1] = torch.nan
        return everything(loss, td)

    plain, spoilt = seen(False), seen(True)
    for ours, theirs in zip(plain, spoilt, strict=True):
        assert torch.equal(ours[[0, 2]], theirs[[0, 2]])
    assert spoilt[-1][1].isnan().any()
