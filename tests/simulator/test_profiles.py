"""Mixes of users: their names and keys. The oracle's agreement shows what the keys do."""

import pytest

from bbq_torchrl.domains import tensorize
from bbq_torchrl.settings import USERS
from bbq_torchrl.simulator import Simulator
from bbq_torchrl.simulator.measured_errors import load_errors
from bbq_torchrl.simulator.profiles import HABITS, MIXES, Mix, profiles_of


def test_the_mixes_have_the_names_that_are_allowed():
    assert all(USERS.test(name) for name in MIXES)
    assert f"one of {', '.join(MIXES)}, or" in USERS.text
    for profiles in MIXES.values():
        assert profiles_of(profiles or "paper") == profiles


def test_users_without_differences_are_those_of_the_paper():
    assert profiles_of([{"share": 0.5}, {"share": 0.5}]) == ()
    assert profiles_of([{"share": 0.5}, {"share": 0.5, "tells": [1, 1]}]) != ()
    assert len(profiles_of([{"share": 0.333, "insists": 1}] * 3)) == 3


@pytest.mark.parametrize(
    ("users", "message"),
    [
        ("folks", "users .*'folks'"),
        ([], r"users .*\[\]"),
        ({"patient": 3}, r"users\[0\]\.patient .*patience"),
        ({"patience": [0, 3]}, r"users\[0\]\.patience .*\[0, 3\]"),
        ({"bears": [4, 3]}, r"users\[0\]\.bears .*\[4, 3\]"),
        ({"tells": 2}, r"users\[0\]\.tells .*2"),
        ([{"share": 0.5}, {"share": 0.6}], r"users .*1\.1"),
        ([{"share": 1}, {"share": 0}], r"users\[1\]\.share .*0"),
        ({"slot_error_prob": {"date": 1.1}}, "slot_error_prob .*'date'"),
        *(({habit: 1.5}, rf"users\[0\]\.{habit} .*1") for habit in HABITS),
    ],
)
def test_invalid_users_are_refused(users, message):
    with pytest.raises(ValueError, match=message):
        profiles_of(users)


def test_error_rates_need_a_slot_of_the_domain_and_an_error_model(movie):
    users = {"slot_error_prob": {"daet": 0.1}}
    with pytest.raises(ValueError, match=r"users\[0\]\.slot_error_prob .*'daet'"):
        Mix(tensorize(movie), profiles_of(users))
    users = {"slot_error_prob": {"date": 0.1}}
    with pytest.raises(ValueError, match="slot_error_prob"):
        Simulator(tensorize(movie), users=users, errors=load_errors(movie))
