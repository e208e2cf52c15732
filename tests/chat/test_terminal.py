"""``bbq chat`` in a real terminal: a pseudo-terminal, with prompt_toolkit and rich at work."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import struct
import sys
import termios
import time
import traceback
import warnings

import pytest

from bbq_torchrl.chat.goals import choose_goal
from bbq_torchrl.chat.terminal import Chat, console, prompt

CURSOR = b"\x1b[6n"  # prompt_toolkit asks where the cursor is
STYLES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b[=>]")
LIMIT = 60


class Terminal:
    """What a person at a terminal does and sees.

    Args:
        run: what runs at the terminal, in a process of its own.
        columns: the terminal's width.
    """

    def __init__(self, run, columns=100):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python 3.12 warns where there are threads
            self.child, self.keys = pty.fork()
        if self.child == 0:
            _become(run)
        self.resize(columns)
        self.seen = ""

    def resize(self, columns):
        fcntl.ioctl(self.keys, termios.TIOCSWINSZ, struct.pack("HHHH", 30, columns, 0, 0))
        os.kill(self.child, signal.SIGWINCH)

    def type(self, keys):
        self.seen = ""
        os.write(self.keys, keys.encode())

    def until(self, text):
        """Returns what is shown, without styles, once it has ``text``."""
        end = time.monotonic() + LIMIT
        while text not in STYLES.sub("", self.seen):
            assert time.monotonic() < end, f"{text!r} is not shown: {self.seen!r}"
            assert self._read(), f"it ended without {text!r}: {self.seen!r}"
        return STYLES.sub("", self.seen)

    def ends(self):
        """Returns the exit code, once the program has ended."""
        while self._read():
            pass
        return os.waitstatus_to_exitcode(os.waitpid(self.child, 0)[1])

    def _read(self):
        if not select.select([self.keys], [], [], LIMIT)[0]:
            raise AssertionError(f"nothing comes after {self.seen!r}")
        try:
            data = os.read(self.keys, 65_536)
        except OSError:  # the other side is closed
            return False
        if CURSOR in data:
            os.write(self.keys, b"\x1b[1;1R")
        self.seen += data.decode(errors="replace")
        return bool(data)


def _become(run):
    """Runs at the pseudo-terminal, with none of pytest's capturing; never returns."""
    signal.alarm(3 * LIMIT)
    code = 1
    try:
        warnings.resetwarnings()
        warnings.simplefilter("ignore")
        sys.stdin, sys.stdout, sys.stderr = os.fdopen(0), os.fdopen(1, "w"), os.fdopen(2, "w")
        os.environ["TERM"] = "xterm-256color"
        for name in ("COLUMNS", "LINES", "NO_COLOR"):
            os.environ.pop(name, None)
        run()
        sys.stdout.flush()
        code = 0
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    os._exit(code)


@pytest.fixture
def terminal(partner, decided):
    """A chat with an agent that asks for the city, once for /why, and at last says thanks."""
    decided(partner.agent, *["request(city)"] * 3, "thanks")
    goal = choose_goal(partner.agent.domain, 1, 0)
    names = dict.fromkeys(partner.agent.domain.slots, "name")

    def run():
        Chat(partner, goal, console(), names=names).run(prompt())

    opened = Terminal(run)
    opened.until("you:")
    yield opened
    os.close(opened.keys)


def test_a_conversation_at_a_terminal_to_its_end(terminal):
    terminal.type("inform(moviename=barbie)\r")
    terminal.until("agent: ")
    terminal.type("/acts\r")
    wide = terminal.until("nats\r\nyou:")
    assert "┃ P(best) ┃" in wide
    terminal.type("/why\r")
    assert "request(city) rather than" in terminal.until("┘\r\nyou:")

    terminal.resize(40)
    terminal.type("/acts\r")
    narrow = terminal.until("nats\r\nyou:")
    assert "\r\n  mean Q: " in narrow
    assert "\r\n  P(best): " in narrow
    assert max(map(len, narrow.replace("\r", "\n").split("\n"))) <= 40

    terminal.type("inform(city=reno)\r")
    terminal.until("agent: ")
    terminal.type("\x1b[A")  # arrow up
    terminal.until("inform(city=reno)")
    terminal.type("\r")
    assert "Failure: " in terminal.until("/quit leaves")
    terminal.type("/quit\r")
    assert terminal.ends() == 0


@pytest.mark.parametrize("key", ["\x03", "\x04"], ids=["Ctrl-C", "Ctrl-D"])
def test_a_key_ends_the_conversation_and_tells_the_outcome(terminal, key):
    terminal.type(key)
    assert "Failure: no booking was offered" in terminal.until("Failure: no booking was offered")
    assert terminal.ends() == 0
