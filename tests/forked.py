"""Runs a command's main function in a child of this process, which has imported all already.

A process of its own would import torch and TorchRL again, which takes seconds. The child has a
working directory, arguments, output and an exit code of its own; what only a fresh interpreter
shows (what is imported, say) needs a real one.
"""

import importlib
import logging
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from contextlib import suppress
from functools import cache, partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

SECONDS = 1_800
"""After so long a child is ended: it hangs."""


def run_script(script, *arguments, cwd, code=0):
    """Runs a script as ``python <script> <arguments>`` does; see :func:`call`."""
    main = partial(runpy.run_path, str(script), run_name="__main__")
    return call(lambda: main() and 0, *arguments, cwd=cwd, code=code)


def call(main, *arguments, cwd, code=0):
    """Calls ``main`` with these command line arguments, which must end with the exit code.

    Returns:
        what it wrote to its standard output, and to its standard error.
    """
    ended, *written = end(main, *arguments, cwd=cwd)
    assert ended == code, written
    return written[0], written[1]


def end(main, *arguments, cwd):
    """Calls ``main``. Returns its exit code, its standard output and its standard error."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        _, status = os.waitpid(start(main, arguments, cwd, out, err), 0)
        for file in (out, err):
            file.seek(0)
        return os.waitstatus_to_exitcode(status), out.read(), err.read()


def start(main, arguments, cwd, out, err):
    """Begins to call ``main``. Returns the child's process id."""
    _import_what_commands_import()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Python 3.12 warns where there are threads
        child = os.fork()
    if child == 0:
        _run(main, arguments, cwd, out, err)
    return child


@cache
def _import_what_commands_import():
    """Imports, once and not in every child, what commands import as they go."""
    of_torchrl = ("bbq_torchrl.exploration", "bbq_torchrl.objectives", "bbq_torchrl.runs.final")
    # tensordict looks for pandas.
    for name in (*of_torchrl, "matplotlib.backends.backend_agg", "pandas", "scipy.optimize"):
        with suppress(ImportError):
            importlib.import_module(name)


def environment():
    """The environment of a Python that finds the package, and what this one was given besides."""
    path = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(path)}


def python(*arguments, cwd, code=0):
    """Runs Python in a process of its own, as a person does; see :func:`call`."""
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=SECONDS,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout, done.stderr


def process(*arguments, cwd):
    """Starts ``train.py`` in a process of its own, with a process group of its own."""
    return subprocess.Popen(
        [sys.executable, str(ROOT / "train.py"), *arguments],
        cwd=cwd,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_until(started, is_so):
    """Waits for a condition, which must become true before the process ends."""
    end = time.monotonic() + SECONDS
    while not is_so():
        assert started.poll() is None, started.communicate()
        assert time.monotonic() < end
        time.sleep(0.005)


def _run(main, arguments, cwd, out, err):
    """Becomes the command; never returns."""
    signal.alarm(SECONDS)
    for number, file in ((1, out), (2, err)):
        os.dup2(file.fileno(), number)
    sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False) for number in (1, 2))
    warnings.resetwarnings()  # pytest's filters make errors of them; those that Python has stay
    for category in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
        warnings.simplefilter("ignore", category)
    logging.getLogger().handlers.clear()  # pytest's
    code = 1
    try:
        os.chdir(cwd)
        sys.argv = ["train.py", *arguments]
        code = main() or 0
    except SystemExit as end:
        code = end.code or 0
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 1)
