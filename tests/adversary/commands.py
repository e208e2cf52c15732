"""Commands in child processes, which tests can stop and kill."""

import importlib
import os
import time
from dataclasses import dataclass
from pathlib import Path

import forked

from bbq_torchrl.cli import console


@dataclass
class Ended:
    """The outcome of a command.

    Attributes:
        code: its exit code; negative: the signal that killed it.
        err: what it printed as an error.
        seconds: of processor time that it took.
    """

    code: int
    err: str
    seconds: float

    def __post_init__(self):
        assert "Traceback" not in self.err, self.err

    @property
    def line(self):
        """The line that it ended with."""
        assert self.err.count("\n") == 1, self.err
        return self.err.strip()


class Command:
    """A process that runs a command."""

    def __init__(self, pid, errors):
        self.pid = pid
        self._errors = errors

    def send(self, number):
        """Sends the process a signal, which has no effect after its end."""
        os.kill(self.pid, number)

    def end(self):
        """Waits for its end."""
        _, status, used = os.wait4(self.pid, 0)
        code, seconds = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
        return Ended(code, self._errors.read_text(), seconds)

    def until(self, is_so):
        """Waits for a condition, which must become true before the process ends."""
        while not is_so():
            assert not self._is_over(), self.end()
            time.sleep(0.005)

    def work(self, seconds):
        """Lets the process work for a number of seconds of processor time, or to its end."""
        ticks = seconds * os.sysconf("SC_CLK_TCK")
        while not self._is_over():
            if sum(int(number) for number in self._fields()[11:13]) >= ticks:
                return
            time.sleep(0.005)

    def _is_over(self):
        return self._fields()[0] == "Z"

    def _fields(self):
        """The kernel's status of the process, from its state on."""
        return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()


class Commands:
    """Starts commands in a folder, which is their working directory."""

    def __init__(self, folder):
        self.folder = folder
        self._count = 0
        for name in ("train", "evaluate", "search"):
            importlib.import_module(console.COMMANDS[name][0])  # once, not in every child

    def start(self, program, *arguments):
        """Starts ``bbq <program> <arguments>``."""
        self._count += 1
        errors = self.folder / f"err-{self._count}"
        with open(os.devnull, "w") as out, errors.open("w") as err:
            pid = forked.start(console.main, (program, *arguments), self.folder, out, err)
        return Command(pid, errors)

    def run(self, program, *arguments, code=0):
        """Runs a command to its end, which must be the exit code."""
        ended = self.start(program, *arguments).end()
        assert ended.code == code, (arguments, ended)
        return ended

    def kill(self, program, *arguments, number, after):
        """Starts a command and sends it a signal after a number of seconds of processor time."""
        command = self.start(program, *arguments)
        command.work(after)
        command.send(number)
        return command.end()
