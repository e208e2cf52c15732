"""Values computed once for many batches: those of the frozen network, and the cache of BBQN."""

import pickle
from copy import deepcopy

import pytest
import torch
from q_transitions import (
    bayes_loss,
    flat,
    gradients,
    heads_loss,
    noisy_loss,
    plain_loss,
    result,
    transitions,
)

# ------------------------------------------------------------------------- frozen values


@pytest.mark.parametrize("make", [plain_loss, bayes_loss, heads_loss])
@pytest.mark.parametrize("replicas", [(), (3,)], ids=str)
def test_a_loss_with_next_state_values_at_hand_is_the_same_loss(make, replicas):
    loss, _ = make(replicas, dtype=torch.double)
    loss.set_keys(next_state_value="known")
    td = transitions(replicas, dtype=torch.double)
    expected, slopes = result(loss, td), gradients(loss, td)
    td["next", "known"] = loss.next_state_values(td)
    td["next", "observation"].fill_(torch.nan)  # nothing of the next state is read any more
    torch.testing.assert_close(result(loss, td), expected)
    torch.testing.assert_close(gradients(loss, td), slopes)


def test_next_state_values_follow_the_freeze_and_not_the_network():
    loss, update = plain_loss((2,))
    td = transitions((2,))
    before = loss.next_state_values(td)
    with torch.no_grad():
        flat(loss, "weight").add_(0.5)
    assert torch.equal(loss.next_state_values(td), before)
    update.step()
    assert not torch.allclose(loss.next_state_values(td), before)
    online = type(loss)(loss.value_network, delay_value=False, action_space="categorical")
    assert loss.has_fixed_targets
    assert not online.has_fixed_targets


@pytest.mark.parametrize(
    ("make", "settings"),
    [
        (plain_loss, {"double_dqn": True}),
        (heads_loss, {"double_dqn": True}),
        (bayes_loss, {"target": "mc"}),
        (bayes_loss, {"target": "mc", "target_noise": "shared"}),
        (noisy_loss, {}),
    ],
)
def test_targets_that_change_from_batch_to_batch_are_not_frozen(make, settings):
    loss, _ = make(**settings)
    assert not loss.has_fixed_targets
    with pytest.raises(RuntimeError, match="the same for every batch"):
        loss.next_state_values(transitions())


# ------------------------------------------------------------------------- the cache of BBQN


def test_the_kl_is_reported_again_until_the_next_epoch_and_its_gradient_is_todays():
    (loss, _), (other, _) = bayes_loss((2,), cache=True), bayes_loss((2,))
    td = transitions((2,))
    td["valid"] = torch.zeros(2, 32).bool()  # the gradient is that of the KL alone
    loss.begin_epoch()
    first = loss(td)["kl"]
    with torch.no_grad():
        flat(loss, "mu").add_(1.0)
    other.load_state_dict(loss.state_dict())
    today = other(td)["kl"]
    assert (today > first).all()
    out = loss(td)
    assert torch.equal(out["kl"], first)
    torch.testing.assert_close(out["loss_value"], loss.kl_temperature * first / 100)
    torch.testing.assert_close(gradients(loss, td), gradients(other, td))
    loss.begin_epoch()
    torch.testing.assert_close(loss(td)["kl"], today)


def test_an_mc_target_caches_the_frozen_standard_deviations():
    # All means are 0: with tiny σ prediction and value are 0, with a large σ⁻ they are not.
    loss, _ = bayes_loss(cache=True, target="mc", hidden=())
    frozen = flat(loss, "rho", target=True)
    with torch.no_grad():
        for tensor in (flat(loss, "mu"), flat(loss, "mu", target=True)):
            tensor.zero_()
        for tensor in (flat(loss, "rho"), frozen):
            tensor.fill_(-40.0)
    td = transitions(ends=-1.0)
    loss.begin_epoch()
    near = loss(td)["td_error"]
    torch.testing.assert_close(near, td["next", "reward"].abs().mean())
    frozen.fill_(10.0)
    torch.testing.assert_close(loss(td)["td_error"], near)
    for copy in (deepcopy(loss), pickle.loads(pickle.dumps(loss))):  # without the cache
        assert copy(td)["td_error"] > near + 1
    loss.begin_epoch()
    assert loss(td)["td_error"] > near + 1
