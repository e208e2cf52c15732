"""A full or read-only disk and unwritable output: a sentence, the right exit code, no lost run."""

import shlex
import shutil
import subprocess
import sys

import pytest
from forked import ROOT, environment

from .cases import KILLS
from .folders import assert_same

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    """Runs a shell script that can mount, as root of a new user namespace."""
    unshare = ["unshare", "--map-root-user", "--mount"]
    probe = [*unshare, "sh", "-c", "mount -t tmpfs -o size=1m none /mnt"]
    if shutil.which("unshare") is None or subprocess.run(probe, capture_output=True).returncode:
        pytest.skip("needs the program unshare, and that a user may mount a tmpfs in a namespace")

    def run(script, cwd):
        return subprocess.run(
            [*unshare, "sh", "-c", script],
            cwd=cwd,
            env=environment(),
            capture_output=True,
            text=True,
            timeout=1_800,
        )

    return run


def command(*arguments):
    return shlex.join([sys.executable, str(ROOT / "train.py"), *arguments])


@pytest.mark.parametrize("attempt", range(max(3, KILLS // 10)))
def test_a_full_disk_is_a_sentence_and_the_run_goes_on(
    disk, references, tmp_path, rng, record_property, attempt
):
    reference = references("bbqn")
    (tmp_path / "disk").mkdir()
    used = sum(path.stat().st_size for path in reference.folder.rglob("*") if path.is_file())
    size = int(rng.uniform(0.05, 1.3) * used / 1024)
    new = command(*reference.overrides, "hydra.run.dir=disk/run")
    script = f"""
        mount -t tmpfs -o size={size}k none disk
        {new} > /dev/null 2> first; echo $? > code
        mount -o remount,size=100m disk
        if [ -e disk/run/config.yaml ]
        then {command("resume=disk/run")}
        else {new}
        fi > second 2>&1
        cp -r disk/run kept
    """
    ended = disk(script, tmp_path)
    first, code = (tmp_path / "first").read_text(), int((tmp_path / "code").read_text())
    print(size, code, first, (tmp_path / "second").read_text(), ended.stderr)

    assert code in (0, 1, 2)
    assert "Traceback" not in first
    if code:
        assert "No space left on device" in first
    assert_same(tmp_path / "kept", reference.folder)
    record_property("a full disk: one sentence, and with room the run went on", 1)
