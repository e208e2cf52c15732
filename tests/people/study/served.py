"""A study served by a process of its own, as a researcher serves it."""

import os
import re
import socket
import subprocess
import sys

from forked import ROOT


class Server:
    """The command line at work on a study file, within a block and on the same port in each."""

    def __init__(self, file):
        self.file, self.port = file, free_port()

    def __enter__(self):
        path = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "people")])
        command = [sys.executable, "-m", "bbq_torchrl.people.study", "serve", str(self.file)]
        self.process = subprocess.Popen(
            [*command, "--talker", "study.fakes:make", "--port", str(self.port)],
            env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        lines = [self.process.stdout.readline() for _ in range(2)]
        assert all(lines), self.process.communicate()[1]
        self.links = dict(re.findall(r"(for \w+): (http\S+)", "".join(lines)))
        return self  # it listens already

    def __exit__(self, *error):
        self.process.kill()
        self.process.communicate(timeout=60)


def free_port():
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        return bound.getsockname()[1]
