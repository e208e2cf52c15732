"""Runs the commands in processes of their own, which may be killed.

Run as a program, this is a server: it imports everything once and forks a process for each command
that a line of JSON on its standard input names. Importing torch and torchrl for each takes seconds.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).resolve().parents[2]

PROGRAMS = {
    "train": "train",
    "evaluate": "bbq_torchrl.evaluate",
    "search": "bbq_torchrl.search.__main__",
    "domains": "bbq_torchrl.calibrate",
    "report": "bbq_torchrl.evaluation.report",
}
"""Command -> the module whose main function it is."""


@dataclass
class Ended:
    """How a command ended.

    Attributes:
        code: its exit code; negative: the signal that killed it.
        out: what it printed.
        err: what it printed as an error.
        seconds: of processor time that it took.
    """

    code: int
    out: str
    err: str
    seconds: float

    def __post_init__(self) -> None:
        assert "Traceback" not in self.err, self.err

    @property
    def line(self) -> str:
        """The one line that it ended by."""
        assert self.err.count("\n") == 1, self.err
        return self.err.strip()


class Command:
    """A process that runs one of :data:`PROGRAMS`."""

    def __init__(self, commands: Commands, pid: int, files: tuple[Path, Path]) -> None:
        self._commands = commands
        self.pid = pid
        self._files = files

    def send(self, number: int) -> None:
        """Sends it a signal; one that is over and not waited for takes it without harm."""
        os.kill(self.pid, number)

    def end(self) -> Ended:
        """Waits for its end."""
        code, seconds = self._commands.ask(wait=self.pid)
        return Ended(int(code), *(path.read_text() for path in self._files), float(seconds))

    def works_in(self, folder: Path) -> bool:
        """Whether it holds the lock of a run folder."""
        process = Path(f"/proc/{self.pid}")
        return any(
            # A file that is open is not locked yet.
            os.path.realpath(link) == os.fspath(folder / ".lock")
            and "FLOCK" in (process / "fdinfo" / link.name).read_text()
            for link in (process / "fd").iterdir()
        )

    def until(self, is_so: Callable[[], object]) -> None:
        """Waits until something is so, which must come before its end."""
        while not is_so():
            assert not self._is_over(), self.end()
            time.sleep(0.005)

    def work(self, seconds: float) -> None:
        """Lets it work for so many seconds of processor time, or to its end."""
        ticks = seconds * os.sysconf("SC_CLK_TCK")
        while not self._is_over():
            if sum(int(number) for number in self._fields()[11:13]) >= ticks:
                return
            time.sleep(0.005)

    def _is_over(self) -> bool:
        return self._fields()[0] == "Z"

    def _fields(self) -> list[str]:
        """What the kernel says of the process, from its state on."""
        return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()


class Commands:
    """Starts commands in a folder, which is their working directory."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._count = 0
        self._server = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=folder,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
        )

    def ask(self, **request: object) -> list[str]:
        """Sends a request to the server; returns the words of its answer."""
        self._server.stdin.write(json.dumps(request) + "\n")
        self._server.stdin.flush()
        return self._server.stdout.readline().split()

    def start(self, program: str, *arguments: str, cwd: Path | None = None) -> Command:
        """Starts one of :data:`PROGRAMS`, in a working directory of its own if one is given."""
        self._count += 1
        files = tuple(self.folder / f"{kind}-{self._count}" for kind in ("out", "err"))
        (pid,) = self.ask(
            program=program,
            arguments=arguments,
            files=[str(path) for path in files],
            cwd=str(cwd or self.folder),
        )
        return Command(self, int(pid), files)

    def run(self, program: str, *arguments: str, code: int = 0) -> Ended:
        """Runs a command to its end, which must be the exit code."""
        ended = self.start(program, *arguments).end()
        assert ended.code == code, (arguments, ended)
        return ended

    def kill(self, program: str, *arguments: str, number: int, after: float) -> Ended:
        """Starts a command and sends it a signal after so many seconds of processor time."""
        command = self.start(program, *arguments)
        command.work(after)
        command.send(number)
        return command.end()

    def close(self) -> None:
        self._server.stdin.close()
        self._server.wait()
        self._server.stdout.close()


def _main(program: str, arguments: list[str]) -> int:
    from bbq_torchrl import interruption

    sys.argv = [f"{program}.py", *arguments]
    interruption.listen()
    main = importlib.import_module(PROGRAMS[program]).main
    return main() or 0 if program == "train" else main(arguments)


def _child(program: str, arguments: list[str], files: list[str], cwd: str) -> None:
    for number, file in enumerate(files, start=1):
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(descriptor, number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.chdir(cwd)
    try:
        code = _main(program, arguments)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def serve() -> None:
    import torch

    for name in (*PROGRAMS.values(), "bbq_torchrl.run", "matplotlib.figure", "scipy.optimize"):
        importlib.import_module(name)
    torch.set_num_threads(1)
    for line in sys.stdin:
        request = json.loads(line)
        if "wait" in request:
            _, status, used = os.wait4(request["wait"], 0)
            print(os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, flush=True)
            continue
        child = os.fork()
        if child == 0:
            _child(**request)
        print(child, flush=True)


if __name__ == "__main__":
    serve()
