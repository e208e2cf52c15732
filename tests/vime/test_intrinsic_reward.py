"""VIMEReward in replay buffers: what is stored, what is read, and whom it depends on."""

from __future__ import annotations

from statistics import median_low

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.custom import PendulumEnv

from bbq_torchrl.vime import DynamicsLoss, DynamicsModel, VIMEReward, information_gain
from bbq_torchrl.vime.running_median import RunningMedian

S, A = 4, 3
BONUS, REWARD = ("next", "intrinsic_reward"), ("next", "reward")


def transitions(*batch, size=S, end=0.2):
    """Random transitions of something like CartPole."""
    action = torch.randint(A, batch)
    terminated = torch.rand(*batch, 1) < end
    return TensorDict(
        {
            "observation": torch.randn(*batch, size),
            "action": action,
            "next": {
                "observation": torch.randn(*batch, size),
                "reward": torch.randn(*batch, 1),
                "done": terminated.clone(),
                "terminated": terminated,
            },
        },
        batch,
    )


def transform(replicas=(), size=S, **settings):
    """A transform whose model starts from the same weights each time."""
    torch.manual_seed(1)
    dynamics = DynamicsModel(size, A, (16,), replicas=replicas)
    torch.seed()
    return VIMEReward(dynamics, **settings)


def buffer(transform, size=1000, batch=32):
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(size), transform=transform, batch_size=batch
    )


def going_on(td):
    return ~td["next", "terminated"].squeeze(-1)


# -- storing ---------------------------------------------------------------------------------


def test_the_bonus_is_the_gain_over_the_median_clipped():
    vime = transform(clip=2.0, median_window=3)
    medians = []
    for rows in (40, 30, 20, 10, 11):
        td = transitions(rows)
        td["next", "observation"][0] = 9.0
        td["next", "terminated"][:2] = torch.tensor([[False], [True]])
        stored = vime.inv(td)
        gain = information_gain(
            vime.dynamics, td["observation"], td["action"], td["next", "observation"]
        )
        medians.append(median_low(gain[going_on(td)].tolist()))
        expected = (gain / median_low(medians[-3:])).clamp(max=2.0) * going_on(td)
        torch.testing.assert_close(stored[BONUS].squeeze(-1), expected)
        assert stored[BONUS][0] == 2.0
        assert stored[BONUS][1] == 0.0
        assert torch.equal(stored[REWARD], td[REWARD])
        assert BONUS not in td.keys(True)  # what is stored is a copy


def test_without_normalizing_it_is_the_gain():
    vime = transform(normalize=False, clip=1e9, step_size=0.5)
    td = transitions(40, end=0.0)
    gain = vime.inv(td)[BONUS].squeeze(-1)
    state = (td["observation"], td["action"], td["next", "observation"])
    torch.testing.assert_close(gain, information_gain(vime.dynamics, *state, step_size=0.5))


def test_the_step_size_cancels():
    td = transitions(40)
    one, other = transform(step_size=1e-3).inv(td), transform(step_size=1.0).inv(td)
    torch.testing.assert_close(one[BONUS], other[BONUS])


def test_states_are_taken_into_the_statistics_once():
    vime = transform()
    stored = [vime.inv(transitions(rows)) for rows in (300, 50)]  # more than one piece
    td = torch.cat(stored)
    states = torch.cat([td["observation"], td["next", "observation"][going_on(td)]])
    assert vime.dynamics.count == len(states)
    torch.testing.assert_close(vime.dynamics.mean, states.mean(0), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(vime.dynamics.var, states.var(0, False), rtol=1e-4, atol=1e-5)
    before = vime.dynamics.count.clone()
    again = vime.inv(td)  # they come with a bonus: kept, and not counted twice
    assert torch.equal(again[BONUS], td[BONUS])
    assert torch.equal(vime.dynamics.count, before)
    vime.forward(td)
    assert torch.equal(vime.dynamics.count, before)


def test_terminal_transitions_get_0_and_decide_nothing():
    td = transitions(60)
    other = td.clone()
    other["next", "observation"][~going_on(td)] = torch.nan
    one, two = transform(), transform()
    stored, also = one.inv(td), two.inv(other)
    assert torch.equal(stored[BONUS], also[BONUS])
    assert not stored[BONUS][~going_on(td)].any()
    assert (stored[BONUS][going_on(td)] > 0).all()
    assert torch.equal(one.dynamics.mean, two.dynamics.mean)


def test_a_store_of_terminal_transitions_alone_leaves_the_median():
    vime = transform()
    vime.inv(transitions(40))
    state = {k: v.clone() for k, v in vime.median.state_dict().items()}
    assert not vime.inv(transitions(5, end=1.0))[BONUS].any()
    assert all(torch.equal(v, state[k]) for k, v in vime.median.state_dict().items())


def test_the_first_store_has_a_bonus_around_1():
    # a spiked buffer: nothing has been learned, and its own median is the measure
    td = transitions(101, end=0.0)
    stored = transform(clip=1e9).inv(td)
    assert stored[BONUS].median() == pytest.approx(1.0)


def test_a_feature_that_appears_is_worth_more_but_not_everything():
    def appear(std_floor):
        vime = VIMEReward(DynamicsModel(S, A, (16,), std_floor=std_floor), clip=1e9)
        for _ in range(4):
            td = transitions(500)
            td["observation"][:, -1] = td["next", "observation"][:, -1] = 0.0
            vime.inv(td)
        td = transitions(500, end=0.0)
        td["observation"][:, -1] = td["next", "observation"][:, -1] = 0.0
        td["next", "observation"][7, -1] = 1.0
        return vime.inv(td)[BONUS].flatten()

    bonus = appear(0.05)
    assert bonus.argmax() == 7
    assert bonus[7] < appear(1e-4)[7] / 2  # some 5,000 states: its own std is .014


@pytest.mark.parametrize("weights", ["map", "mc"])
def test_mc_is_one_draw_a_store_and_map_none(weights):
    td = transitions(30, end=0.0)
    vime = transform(weights=weights, normalize=False, clip=1e9)
    torch.manual_seed(5)
    gain = vime.inv(td)[BONUS].squeeze(-1)
    state = (td["observation"], td["action"], td["next", "observation"])
    torch.manual_seed(5)
    noise = torch.randn_like(vime.dynamics.network.posterior.mu) if weights == "mc" else None
    torch.testing.assert_close(gain, information_gain(vime.dynamics, *state, noise=noise))


def test_one_hot_actions_single_rows_and_batches_of_any_shape():
    td = transitions(12, end=0.0)
    expected = transform().inv(td)[BONUS]
    one_hot = td.clone()
    one_hot["action"] = torch.nn.functional.one_hot(td["action"], A)
    assert torch.equal(transform().inv(one_hot)[BONUS], expected)
    assert torch.equal(transform().inv(td.reshape(3, 4))[BONUS], expected.reshape(3, 4, 1))
    assert transform().inv(td[0])[BONUS].shape == (1,)
    assert transform().inv(td[:0])[BONUS].shape == (0, 1)


def test_the_mean_bonus_of_what_was_stored_is_reported_once():
    vime = transform()
    stored = [vime.inv(transitions(rows)) for rows in (300, 50)]
    vime.inv(stored[0])  # they come with a bonus: nothing new
    expected = torch.cat([td[BONUS] for td in stored]).mean()
    torch.testing.assert_close(
        vime.pop_metrics(), {"intrinsic_reward": expected}, check_dtype=False
    )
    assert vime.pop_metrics()["intrinsic_reward"].isnan()


def test_padding_does_not_change_a_digit_of_the_report():
    td = transitions(3, 700)
    td["valid"] = torch.arange(700) < torch.tensor([[700], [411], [0]])
    short = td[:, :411].clone()
    means = []
    for rows in (td, short):
        vime = transform((3,))
        stored = vime.inv(rows)
        means.append(vime.pop_metrics()["intrinsic_reward"])
    assert means[0][1] == means[1][1]
    assert means[0][1] == pytest.approx(float(stored[BONUS][1].mean()), rel=1e-5)
    assert means[0][2].isnan()


# -- replicas --------------------------------------------------------------------------------


@pytest.mark.parametrize("weights", ["map", "mc"])
@pytest.mark.parametrize(
    ("lengths", "others"), [((90, 70, 10), (270, 70, 530)), ((1, 1, 1), (300, 1, 530))]
)
def test_elements_do_not_depend_on_one_another_nor_on_padding(weights, lengths, others):
    # element 1 is the same in both; the others' rows, and so the padding, are not
    own = lengths[1]
    td, other = (transitions(3, max(n), size=268) for n in (lengths, others))
    other[1, :own] = td[1, :own]
    stored = []
    for rows, counts in ((td, lengths), (other, others)):
        rows["valid"] = torch.arange(rows.shape[1]) < torch.tensor(counts).unsqueeze(-1)
        for key in ("observation", ("next", "observation")):
            rows[key][~rows["valid"]] = torch.nan
        rows["action"][~rows["valid"]] = -1
        vime = transform((3,), 268, weights=weights)
        vime.set_seeds([7, 8, 9] if rows is td else [1, 8, 2])
        first = vime.inv(rows)
        again = vime.inv(rows)
        stored.append((first, again, vime))
    for one, two in zip(stored[0][:2], stored[1][:2], strict=True):
        assert torch.equal(one[BONUS][1, :own], two[BONUS][1, :own])
        assert not one[BONUS][~one["valid"]].any()
    state = stored[0][2].state_dict()
    assert not torch.equal(state["dynamics.mean"][0], stored[1][2].dynamics.mean[0])
    for name, value in state.items():
        if "prior" not in name:
            assert torch.equal(value[1], stored[1][2].state_dict()[name][1])


def test_replicas_are_transforms_side_by_side():
    together = transform((2, 2))
    td = transitions(2, 2, 50)
    bonus = together.inv(td)[BONUS]
    state = transform((2, 2)).dynamics.state_dict()
    for i in range(2):
        for j in range(2):
            alone = transform()
            alone.dynamics.load_state_dict(
                {k: v if k.endswith("prior_rho") else v[i, j] for k, v in state.items()}
            )
            torch.testing.assert_close(alone.inv(td[i, j])[BONUS], bonus[i, j])


def test_seeds_restart_the_noise_of_each_element():
    vime = transform((2,), weights="mc", normalize=False)
    td = transitions(2, 20, end=0.0)
    vime.inv(td)  # the statistics change with the first store
    gains = []
    for seeds in ((3, 4), (3, 5), (3, 4)):
        vime.set_seeds(seeds)
        vime.dynamics.count.zero_()
        gains.append(vime.inv(td)[BONUS])
    assert torch.equal(gains[0], gains[2])
    assert torch.equal(gains[0][0], gains[1][0])
    assert not torch.equal(gains[0][1], gains[1][1])
    with pytest.raises(ValueError, match=r"seeds must be 2, one for each replica, got 1"):
        vime.set_seeds([3])


# -- reading ---------------------------------------------------------------------------------


def test_reading_adds_the_bonus_to_the_reward_that_is_read():
    vime = transform(eta=0.3)
    memory = buffer(vime)
    td = transitions(100)
    memory.extend(td)
    stored = memory._storage.get(slice(0, 100)).clone()
    assert torch.equal(stored[REWARD], td[REWARD])
    for _ in range(3):
        batch = memory.sample()
        index = batch["index"]
        expected = stored[REWARD][index] + 0.3 * stored[BONUS][index]
        torch.testing.assert_close(batch[REWARD], expected)
        whole = memory[:]
        torch.testing.assert_close(whole[REWARD], stored[REWARD] + 0.3 * stored[BONUS])
    assert torch.equal(memory._storage.get(slice(0, 100))[REWARD], td[REWARD])


def test_what_is_read_is_not_changed():
    vime = transform(eta=1.0)
    rows = vime.inv(transitions(3, 8))
    before = rows.clone()
    once, twice = vime(rows), vime(rows)
    assert torch.equal(once[REWARD], twice[REWARD])
    assert not torch.equal(once[REWARD], before[REWARD])
    assert (rows == before).all()
    view = rows[:, :4]  # of memory that is used again
    vime(view)
    assert (rows == before).all()


def test_each_replica_may_have_an_eta():
    vime = transform((3,), eta=torch.tensor([0.0, 0.3, 2.0]))
    td = vime.inv(transitions(3, 20))
    torch.testing.assert_close(
        vime(td)[REWARD], td[REWARD] + torch.tensor([0.0, 0.3, 2.0])[:, None, None] * td[BONUS]
    )
    assert "eta" not in vime.state_dict()
    with pytest.raises(
        ValueError, match=r"eta must be one number or have the replicas' shape \[3\]"
    ):
        transform((3,), eta=torch.ones(2))
    with pytest.raises(ValueError, match="eta must be at least 0 and finite, got"):
        transform((2,), eta=torch.tensor([1.0, -1.0]))


def test_eta_0_leaves_the_reward():
    vime = transform(eta=0.0)
    td = vime.inv(transitions(20))
    assert torch.equal(vime(td)[REWARD], td[REWARD])


def test_single_rows_can_be_added_and_stored_bonuses_are_kept():
    vime = transform()
    memory = buffer(vime)
    for row in transitions(5):
        memory.add(row)
    assert len(memory) == 5
    other = buffer(transform())
    rows = memory._storage.get(slice(0, 5)).clone()
    other.extend(rows)
    assert torch.equal(other._storage.get(slice(0, 5))[BONUS], rows[BONUS])


def test_keys_can_have_other_names():
    td = transitions(20)
    expected = transform()
    stored = expected.inv(td)
    td = td.clone()
    td["agent", "state"] = td.pop("observation")
    td["next", "agent", "state"] = td["next"].pop("observation")
    td["act"] = td.pop("action")
    td["next", "pay"] = td["next"].pop("reward")
    td["next", "over"] = td["next"].pop("terminated")
    vime = transform(
        observation_key=("agent", "state"),
        action_key="act",
        reward_key="pay",
        terminated_key="over",
        intrinsic_reward_key=("agent", "bonus"),
    )
    assert vime.out_keys_inv == [("next", "agent", "bonus")]
    out = vime.inv(td)
    assert torch.equal(out["next", "agent", "bonus"], stored[BONUS])
    assert torch.equal(vime(out)["next", "pay"], expected(stored)[REWARD])


def test_states_round_trip_through_a_replay_buffer():
    one, two = (buffer(transform(weights="map", median_window=2)) for _ in range(2))
    for rows in (30, 20, 10):
        one.extend(transitions(rows))
    two.load_state_dict(one.state_dict())
    td = transitions(15)
    one.extend(td)
    two.extend(td)
    stored = [memory._storage.get(slice(60, 75))[BONUS] for memory in (one, two)]
    assert torch.equal(*stored)
    assert stored[0].any()


# -- learning --------------------------------------------------------------------------------


def test_what_has_been_learned_is_worth_less():
    # s' = s + the action's step, and the model only ever sees the left half
    def region(rows, low, high):
        td = transitions(rows, end=0.0)
        td["observation"] = torch.empty(rows, 2).uniform_(low, high)
        step = torch.tensor([[0.5, 0.0], [0.0, 0.5], [-0.5, -0.5]])[td["action"]]
        td["next", "observation"] = td["observation"] + step
        return td

    vime = VIMEReward(DynamicsModel(2, A, (32,), noise_std=0.3), normalize=False, clip=1e9)
    loss = DynamicsLoss(vime.dynamics, num_data=500)
    optimizer = torch.optim.Adam(loss.parameters(), 1e-2)
    # the statistics are those of both halves, so that standardizing favors neither
    vime.inv(torch.cat([region(500, -2, 0), region(500, 0, 2)]))
    inside, outside = region(200, -2, 0), region(200, 0.5, 2)

    def gains():
        return [
            float(
                information_gain(
                    vime.dynamics, td["observation"], td["action"], td["next", "observation"]
                ).mean()
            )
            for td in (inside, outside)
        ]

    before = gains()
    seen = region(500, -2, 0)
    for _ in range(150):
        optimizer.zero_grad()
        loss(seen[torch.randint(500, (64,))])["loss"].backward()
        optimizer.step()
    after = gains()
    assert after[0] < before[0] / 10
    assert after[0] < after[1] / 3


# -- errors ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"weights": "mean"}, r"weights must be one of \['map', 'mc'\], got 'mean'"),
        ({"eta": -1.0}, "eta must be finite and not negative, got -1.0"),
        ({"eta": float("nan")}, "eta must be finite"),
        ({"step_size": 0.0}, "step_size must be positive, got 0.0"),
        ({"clip": 0.0}, "clip must be positive, got 0.0"),
        ({"median_window": 0}, "median_window must be at least 1, got 0"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(ValueError, match=message):
        transform(**settings)


def test_it_refuses_environments_and_other_replicas():
    with pytest.raises(ValueError, match="transform of replay buffers"):
        TransformedEnv(PendulumEnv(), transform())
    with pytest.raises(ValueError, match="transform of replay buffers"):
        TransformedEnv(PendulumEnv(), Compose(transform()))
    with pytest.raises(ValueError, match=r"must begin with the replicas \[2\], got \[3, 8\]"):
        transform((2,)).inv(transitions(3, 8))
    with pytest.raises(KeyError, match="stored without this transform"):
        transform()(transitions(5))


# -- the running median ----------------------------------------------------------------------


def test_the_running_median_is_that_of_the_last_medians():
    median = RunningMedian((2,), 3)
    seen = [[], []]
    for n in (3, 1, 4, 5, 2, 6):
        values, counts = torch.randn(2, n), torch.rand(2, n) < 0.7
        out = median.update(values, counts)
        for k in range(2):
            counted = values[k][counts[k]].tolist()
            if counted:
                seen[k].append(median_low(counted))
            if seen[k]:
                assert out[k] == pytest.approx(median_low(seen[k][-3:]))
            else:
                assert out[k].isnan()


def test_the_running_medians_window_must_be_positive():
    with pytest.raises(ValueError, match="window must be at least 1, got 0"):
        RunningMedian((), 0)
