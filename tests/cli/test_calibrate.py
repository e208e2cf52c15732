"""The command that finds how many errors make a domain how difficult."""

import re

import pytest

from bbq_torchrl.cli import calibrate
from bbq_torchrl.domains import load_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.trainers import evaluate

LINE = re.compile(
    r"reference_slot_error_prob: (\S+)  # ± (\S+); careful succeeds in (\S+) ± (\S+) of 2000 "
    r"dialogues\n"
)


@pytest.fixture
def calibrated(restaurant_folder, capsys):
    """Calibrates a domain. Returns the exit code and what was written."""

    def run(*given, folder=restaurant_folder):
        code = calibrate.main(["calibrate", "domain=folder", f"domain.path={folder}", *given])
        return code, *capsys.readouterr()

    return run


def test_at_the_probability_found_the_policy_succeeds_as_often_as_wanted(
    calibrated, restaurant_folder
):
    wanted = 0.5
    choices = ("policy=careful", f"success={wanted}", "dialogues=2000", "batch=2000")
    code, out, err = calibrated(*choices)
    assert code == 0
    probability, uncertain, rate, error = map(float, LINE.fullmatch(out).groups())
    assert 0 < probability < 1
    assert error == pytest.approx((rate * (1 - rate) / 2000) ** 0.5, abs=1e-4)
    # Other users tell the slope: how far the probability is off if the rate is one error off.
    tried = re.findall(r"slot_error_prob=(\S+): careful succeeds in (\S+)", err)
    (near, high), (far, low) = (tuple(map(float, pair)) for pair in tried[-2:])
    assert uncertain == pytest.approx((0.25 / 2000) ** 0.5 * (far - near) / (high - low), rel=0.05)
    # Other users, played by hand.
    env = DialogueEnv(
        load_domain(restaurant_folder), batch_size=(4000,), slot_error_prob=probability, seed=1
    )
    played = evaluate(env, scripted_policy("careful", env), 4000, seed=77).success
    both = (0.25 / 2000 + 0.25 / 4000) ** 0.5
    assert abs(played.double().mean().item() - wanted) < 4 * both + 0.01
    assert abs(rate - wanted) < 4 * (2 * 0.25 / 2000) ** 0.5 + 0.01


def test_a_rate_is_reached_up_to_the_end_and_refused_beyond(calibrated):
    code, out, err = calibrated("success=0.99", "dialogues=200")
    assert (code, out) == (2, "")
    said = r"error: success=0.99 cannot be reached: with .*slot_error_prob=0, rule succeeds in no "
    most = re.match(said + r"more than (\S+) ±", err.splitlines()[-1]).group(1)
    code, out, _ = calibrated(f"success={most}", "dialogues=200")
    assert code == 0
    assert out.startswith("reference_slot_error_prob: 0 ")
