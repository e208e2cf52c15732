"""The bonus that VIMEReward gives to what is stored, and what it depends on."""

from __future__ import annotations

from statistics import median_low

import pytest
import torch
from rewarded import BONUS, REWARD, going_on, transform, transitions

from bbq_torchrl.vime import information_gain


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


def test_ends_may_be_numbers():
    td = transitions(60)
    expected = transform().inv(td)[BONUS]
    td["next", "terminated"] = td["next", "terminated"].to(torch.uint8)
    assert torch.equal(transform().inv(td)[BONUS], expected)


def test_a_store_of_terminal_transitions_alone_leaves_the_median():
    vime = transform()
    vime.inv(transitions(40))
    state = {k: v.clone() for k, v in vime.median.state_dict().items()}
    assert not vime.inv(transitions(5, ends=1.0))[BONUS].any()
    assert all(torch.equal(v, state[k]) for k, v in vime.median.state_dict().items())


@pytest.mark.parametrize("weights", ["map", "mc"])
def test_mc_is_one_draw_a_store_and_map_none(weights):
    td = transitions(30, ends=0.0)
    vime = transform(weights=weights, normalize=False, clip=1e9, step_size=0.5)
    torch.manual_seed(5)
    gain = vime.inv(td)[BONUS].squeeze(-1)
    state = (td["observation"], td["action"], td["next", "observation"])
    torch.manual_seed(5)
    noise = torch.randn_like(vime.dynamics.network.posterior.mu) if weights == "mc" else None
    expected = information_gain(vime.dynamics, *state, noise=noise, step_size=0.5)
    torch.testing.assert_close(gain, expected)


def test_single_rows_and_batches_of_any_shape():
    td = transitions(12, ends=0.0)
    expected = transform().inv(td)[BONUS]
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
    td = transitions(2, 20, ends=0.0)
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
