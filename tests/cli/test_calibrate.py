"""The command that finds how many errors make a domain how difficult."""

from __future__ import annotations

import re
import shutil

import pytest

from bbq_torchrl import calibrate
from bbq_torchrl.domains import load_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.evaluation.rollouts import evaluate

LINE = re.compile(
    r"reference_slot_error_prob: (\S+)  # ± (\S+); careful succeeds in (\S+) ± (\S+) of 2000 "
    r"dialogues\n"
)


def test_at_the_probability_found_the_policy_succeeds_as_often_as_wanted(capsys, restaurant_folder):
    wanted = 0.5
    arguments = [
        "calibrate",
        "domain=folder",
        f"domain.path={restaurant_folder}",
        "policy=careful",
        f"success={wanted}",
        "dialogues=2000",
        "batch=2000",
    ]
    assert calibrate.main(arguments) == 0
    out, err = capsys.readouterr()
    match = LINE.fullmatch(out)
    assert match, out
    probability, uncertain, rate, error = map(float, match.groups())
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


def test_the_rate_at_an_end_can_be_reached(capsys, restaurant_folder):
    where = ("domain=folder", f"domain.path={restaurant_folder}", "dialogues=200")
    assert calibrate.main(["calibrate", "success=0.99", *where]) == 2
    most = re.search(r"in no more than (\S+) ±", capsys.readouterr().err).group(1)
    assert calibrate.main(["calibrate", f"success={most}", *where]) == 0
    assert capsys.readouterr().out.startswith("reference_slot_error_prob: 0 ")


@pytest.mark.parametrize(
    ("success", "said"),
    [(0.99, "slot_error_prob=0, rule succeeds in no more"), (0.0, "=1, rule succeeds in no less")],
)
def test_a_rate_that_cannot_be_reached_is_refused(
    capsys, restaurant_folder, tmp_path, success, said
):
    folder = shutil.copytree(restaurant_folder, tmp_path / "domain")
    if success == 0:  # users without a wish, whose area alone is misheard
        (folder / "goals.jsonl").write_text('{"constraints": {}, "requests": []}\n')
        (folder / "values.json").write_text('{"area": ["north"]}\n')
    where = ("domain=folder", f"domain.path={folder}", "dialogues=200")
    assert calibrate.main(["calibrate", f"success={success}", *where]) == 2
    out, err = capsys.readouterr()
    assert not out
    message = err.splitlines()[-1]
    assert message.startswith(f"error: success={success} cannot be reached: with ")
    assert said in message


def test_help_says_what_there_is(capsys):
    assert calibrate.main(["--help"]) == 0
    assert "python -m bbq_torchrl.domains calibrate" in capsys.readouterr().out
