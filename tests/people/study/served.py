"""A study served by a process of its own, as a researcher serves it."""

import os
import re
import socket
import subprocess
import sys

from forked import ROOT


class Server:
    """The command line at work on a study file.

    Args:
        file: the study file.
        talker: where the agents come from.
    """

    def __init__(self, file, talker="study.fakes:make"):
        self.file, self.talker = file, talker
        self.port = free_port()
        self.process = None
        self.links = {}

    def start(self):
        path = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "people")])
        command = [
            *(sys.executable, "-m", "bbq_torchrl.people.study", "serve", str(self.file)),
            *("--talker", self.talker, "--port", str(self.port)),
        ]
        self.process = subprocess.Popen(
            command,
            env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        lines = [self.process.stdout.readline() for _ in range(2)]
        if not all(lines):
            raise RuntimeError(self.process.communicate()[1])
        self.links = dict(re.findall(r"(for \w+): (http\S+)", "".join(lines)))
        return self  # it listens already

    def kill(self):
        if self.process is not None:
            self.process.kill()
            self.process.communicate(timeout=60)
            self.process = None

    def __enter__(self):
        return self.start()

    def __exit__(self, *error):
        self.kill()


def free_port():
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        return bound.getsockname()[1]
