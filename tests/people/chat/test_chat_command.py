"""``bbq chat``: sessions of typed lines from beginning to end, and the keys of a terminal."""

import io
import sys
from pathlib import Path

import pytest
import yaml
from acts import HOSTILE, Acts
from prompt_toolkit.application import create_app_session
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput
from rich.console import Console

from bbq_torchrl.people.chat import Partner, __main__
from bbq_torchrl.people.chat.terminal import Chat, prompt
from bbq_torchrl.people.dialogue.judge import Judge, choose_goal

SESSIONS = yaml.safe_load(Path(__file__).with_name("sessions.yaml").read_text(encoding="utf-8"))


def play(partner, goal, lines):
    """Returns whether it was a success, and what was on the screen."""
    screen = io.StringIO()
    todo = iter([*lines, None])
    chat = Chat(partner, goal, Console(file=screen, width=100), names={"city": "city"})
    return chat.run(lambda: next(todo)), screen.getvalue()


def test_goals_that_are_drawn_can_be_met(movie):
    judge = Judge(movie)
    assert all(judge.is_attainable(choose_goal(movie, None, seed)) for seed in range(50))


@pytest.mark.parametrize("case", SESSIONS, ids=lambda case: case["what"])
def test_a_session_shows_what_was_asked_for(agents, mouth, decided, case):
    partner = Partner(agents[case.get("agent", "bbqn")], Acts(), mouth, rules=())
    decided(partner.agent, *case.get("decides", ()))
    goal = choose_goal(partner.agent.domain, 1, 0) if "goal" in case else None
    success, shown = play(partner, goal, case["lines"])
    assert success is case["success"]
    found = {text: shown.count(text) for text in case["shows"]}
    wanted = {text: found[text] or 1 if n is True else n for text, n in case["shows"].items()}
    assert found == wanted


UNREADABLE = ["", "x" * 1_000_000, "\x00\x07"]


def test_a_session_of_typed_lines_hostile_ones_too(runs, understand, tmp_path, monkeypatch, capsys):
    understand.save(file := tmp_path / "few.npz")
    # Who has learned little asks again at times, but not for ever.
    told = ["two tickets for barbie in seattle please", "/acts", "/why"] * 3
    lines = [*UNREADABLE, *told, *HOSTILE]
    raw = "\n".join(lines).encode("utf-8", "surrogatepass")
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(raw), encoding="utf-8"))
    command = [str(runs / "bbqn"), "--plain", "--goal", "1", "--understander", str(file)]
    assert __main__.main(command) == 0
    shown = capsys.readouterr().out
    assert "moviename=barbie" in shown
    assert "a message may have at most 1,000 characters, this one has 1,000,000" in shown
    assert "Failure: " in shown
    assert "P(best)" in shown
    assert "you: two tickets for barbie in seattle please\n" in shown
    assert len(shown) < 20_000


def test_a_key_that_cannot_be_sent_is_told_before_a_run_is_looked_for(monkeypatch, capsys):
    monkeypatch.setenv("BBQ_ENDPOINT_KEY", "secret\n")
    endpoint = ["--nlu", "endpoint", "--url", "http://x/v1", "--model", "m"]
    assert __main__.main(["nowhere", *endpoint, "--plain"]) == 2
    error = capsys.readouterr().err
    assert "endpoint's key" in error
    assert "secret" not in error
    assert __main__.main(["nowhere", *endpoint[:4]]) == 2
    assert "--model" in capsys.readouterr().err


KEYS = {
    "arrow up brings back what was typed": ("inform(city=reno)\r|\x1b[A\r|/quit\r", "agent: ", 2),
    "tab completes a command": ("/wh\t\r|\x04", "Nothing was said yet.", 1),
    "Ctrl-C ends the conversation": ("\x03", "Failure: no booking was offered", 1),
    "Ctrl-D does too": ("\x04", "Failure: no booking was offered", 1),
}


@pytest.mark.parametrize(("typed", "shown", "times"), KEYS.values(), ids=KEYS)
def test_a_key_of_a_terminal(partner, decided, typed, shown, times):
    decided(partner.agent, *["request(city)"] * 2)
    screen, lines = io.StringIO(), iter(typed.split("|"))
    console = Console(file=screen, force_terminal=True, color_system=None, width=100)
    names = dict.fromkeys(partner.agent.domain.slots, "name")
    chat = Chat(partner, choose_goal(partner.agent.domain, 1, 0), console, names=names)
    with create_pipe_input() as keys, create_app_session(input=keys, output=DummyOutput()):
        read = prompt()
        chat.run(lambda: keys.send_text(next(lines)) or read())
    assert screen.getvalue().count(shown) == times
