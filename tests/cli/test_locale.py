"""Commands in folders whose names are not UTF-8: by the locale, or since they are no text."""

import os
import shutil
import subprocess
import sys

import pytest
from forked import ROOT, environment
from tiny import TINY

pytestmark = pytest.mark.slow

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


@pytest.fixture(scope="module")
def latin(tmp_path_factory):
    """The environment of a locale of ISO 8859-1, which is made for it."""
    folder = tmp_path_factory.mktemp("locales")
    made = folder / "en_US.ISO-8859-1"
    if shutil.which("localedef") is None:
        pytest.skip("needs localedef")
    subprocess.run(["localedef", "-i", "en_US", "-f", "ISO-8859-1", made], capture_output=True)
    if not made.is_dir():
        pytest.skip("needs the sources of locales")
    return {"LOCPATH": str(folder), "LC_ALL": made.name, "PYTHONUTF8": "0"}


@pytest.mark.parametrize("locale", ["ISO 8859-1", "ASCII", "UTF-8"])
def test_a_run_is_trained_resumed_and_evaluated_in_a_folder_of_any_name(locale, latin, tmp_path):
    chosen = {"ISO 8859-1": latin, "ASCII": ASCII, "UTF-8": {"LC_ALL": "C.UTF-8"}}[locale]
    name = "\xe9".encode("latin-1" if locale == "UTF-8" else "utf-8")
    folder = os.path.join(os.fsencode(tmp_path), name)
    os.mkdir(folder)

    def run(*arguments, code=0):
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=folder,
            env=environment() | chosen,
            capture_output=True,
            timeout=1_800,
        )
        assert done.returncode == code, done.stdout + done.stderr
        assert b"Traceback" not in done.stderr
        return done

    train, keys = ROOT / "train.py", (*TINY, "agent=dqn")
    run(train, *keys, "hydra.run.dir=run")
    run(train, "resume=run", "protocol.rounds=3")
    bbq = ("-m", "bbq_torchrl.cli.console")
    assert b'"mode"' in run(*bbq, "evaluate", "policy=run", "dialogues=6").stdout
    run(train, "--multirun", *keys, "seed=0,1", "hydra.launcher.n_jobs=1", "hydra.sweep.dir=sweep")
    log = os.path.join(folder, b"sweep", b"1_dqn_epsilon_greedy_full_seed1", b"train.log")
    with open(log, encoding="utf-8") as file:
        assert "everything is in" in file.read()
    refused = run(train, *keys, "hydra.run.dir=other", "logger=tensorboard", code=1)
    assert b"logger=tensorboard needs a run folder whose name is UTF-8" in refused.stderr
