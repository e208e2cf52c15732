"""A signal that ends a command at once takes the sweep's workers with it."""

import subprocess
import sys

SCRIPT = """
import os, signal, time

from joblib.externals.loky.backend import get_context

from bbq_torchrl.utils import interruption

if __name__ == "__main__":
    worker = get_context("loky").Process(target=time.sleep, args=(600,))
    worker.start()
    interruption.listen()
    interruption.tell(lambda: "in a test", lambda: "it is over")
    os.kill(os.getpid(), signal.SIGTERM)
"""


def test_workers_of_joblib_end_with_the_command(tmp_path):
    script = tmp_path / "sweep.py"
    script.write_text(SCRIPT)
    # The worker has the same stdout, which is at its end only once the worker is gone.
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)

    assert ended.returncode == 143
    assert ended.stderr == "interrupted in a test: it is over\n"
