"""``bbq chat`` at a terminal: keys that prompt_toolkit reads, and what rich shows."""

from __future__ import annotations

import io

import pytest
from prompt_toolkit.application import create_app_session
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput
from rich.console import Console

from bbq_torchrl.people.chat.terminal import Chat, prompt
from bbq_torchrl.people.dialogue.judge import choose_goal


@pytest.fixture
def typed(partner, decided):
    """Types in a chat with an agent that asks for the city."""
    decided(partner.agent, *["request(city)"] * 2)
    names = dict.fromkeys(partner.agent.domain.slots, "name")

    def shown(*lines):
        screen = io.StringIO()
        console = Console(file=screen, force_terminal=True, color_system=None, width=100)
        goal = choose_goal(partner.agent.domain, 1, 0)
        with (
            create_pipe_input() as keyboard,
            create_app_session(input=keyboard, output=DummyOutput()),
        ):
            read, todo = prompt(), iter(lines)

            def type_and_read():
                keyboard.send_text(next(todo))
                return read()

            Chat(partner, goal, console, names=names).run(type_and_read)
        return screen.getvalue()

    return shown


def test_arrow_up_brings_back_what_was_typed(typed):
    assert typed("inform(city=reno)\r", "\x1b[A\r", "/quit\r").count("agent: ") == 2


def test_tab_completes_a_command(typed):
    assert "Nothing was said yet." in typed("/wh\t\r", "\x04")


@pytest.mark.parametrize("key", ["\x03", "\x04"], ids=["Ctrl-C", "Ctrl-D"])
def test_a_key_ends_the_conversation_and_tells_the_outcome(typed, key):
    assert "Failure: no booking was offered" in typed(key)
