"""The command ``bbq``: every command by one name."""

import sys

import pytest

from bbq_torchrl.cli import console
from bbq_torchrl.utils import interruption
from bbq_torchrl.utils.output import needed


@pytest.fixture(autouse=True)
def deaf(monkeypatch):
    """Signals of the test's own process stay as they are."""
    monkeypatch.setattr(interruption, "listen", lambda: None)


def bbq(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["/usr/bin/bbq", *arguments])
    return console.main()


def test_help_names_every_command(monkeypatch, capsys):
    assert bbq(monkeypatch) == bbq(monkeypatch, "--help") == 0
    out = capsys.readouterr().out
    assert all(f"\n  {name} " in out for name in console.COMMANDS)


def test_an_unknown_command_is_refused_with_those_that_there_are(monkeypatch, capsys):
    assert bbq(monkeypatch, "trian") == 2
    names = ", ".join(console.COMMANDS)
    assert capsys.readouterr().err == f"error: the command must be one of {names}, got 'trian'\n"


def test_what_follows_the_command_is_the_commands(monkeypatch, capsys):
    assert bbq(monkeypatch, "evaluate", "policy=rule", "dialogues=20", "batch=20") == 0
    assert '"dialogues": 20' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "extra"),
    [(("python-crfsuite", "pycrfsuite"), "language"), (("optuna", "optuna", "search"), "search")],
)
def test_a_missing_library_is_named_with_the_extra_that_installs_it(given, extra, monkeypatch):
    monkeypatch.setitem(sys.modules, given[1], None)
    needed.cache_clear()
    message = rf"{given[0]} is needed and not installed: pip install .*\[{extra}\]"
    with pytest.raises(ModuleNotFoundError, match=message):
        needed(*given)
