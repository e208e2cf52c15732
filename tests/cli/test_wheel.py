"""The wheel: installed without the checkout it trains, and says what CITATION.cff says."""

import json
import os
import re
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest
import yaml
from tiny import TINY

from bbq_torchrl.cli.console import COMMANDS
from bbq_torchrl.utils.output import install_command

ROOT = Path(__file__).resolve().parents[2]

SAYS = """
import json
from importlib.metadata import metadata
import gymnasium
import bbq_torchrl.envs.gymnasium
from bbq_torchrl.cli.console import COMMANDS
from bbq_torchrl.utils.output import install_command
about = metadata("bbq-torchrl")
print(json.dumps({
    "file": bbq_torchrl.__file__,
    "author": about["Author"],
    "version": about["Version"],
    "keywords": about["Keywords"].split(","),
    "hint": install_command("search"),
    "actions": int(gymnasium.make("bbq_torchrl/MovieDialogue-v0").action_space.n),
}))
"""


def test_a_checkout_is_installed_by_its_folder():
    assert install_command("search") == f"pip install -e '{ROOT}[search]'"


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The Python of an environment with the wheel, which finds all else where this one does."""
    folder = tmp_path_factory.mktemp("wheel")
    _run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, ROOT], folder)
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "venv", with_pip=False)
    python = folder / "venv" / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", python]
    _run([*pip, "install", "-q", "--no-deps", wheel], folder)
    (packages,) = (folder / "venv").glob("lib/python*/site-packages")
    # A path file of a path file is not read, so that an editable install stays out.
    (packages / "everything_else.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    return python


@pytest.mark.slow
def test_the_wheel_trains(python, tmp_path):
    _run([python.with_name("bbq"), "train", *TINY, "agent=dqn", "hydra.run.dir=run"], tmp_path)
    assert json.loads((tmp_path / "run" / "result.json").read_text())["rounds"] == 2


@pytest.mark.slow
def test_the_wheel_says_what_it_is(python, tmp_path):
    said = json.loads(_run([python, "-c", SAYS], tmp_path).splitlines()[-1])
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert Path(said["file"]).is_relative_to(python.parents[1])
    assert [said["author"]] == [author["name"] for author in citation["authors"]]
    assert said["version"] == citation["version"]
    assert sorted(said["keywords"]) == sorted(citation["keywords"])
    assert said["hint"].startswith("pip install 'bbq-torchrl[search] @ file:///")
    assert said["actions"] == 39


@pytest.mark.slow
def test_the_helps_of_the_wheel_name_what_it_has(python, tmp_path):
    pages = set()
    for command in COMMANDS:
        said = _run([python.with_name("bbq"), command, "--help"], tmp_path)
        assert "train.py" not in said, command
        pages |= {Path(named) for named in re.findall(r"\S+\.md\b", said)}
    assert {page.stem for page in pages} >= {"configuration", "scale", "people"}
    for page in pages:
        assert page.is_file()
        assert page.is_relative_to(python.parents[1])


def _run(command, folder):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    given = {"cwd": folder, "env": environment, "stdout": subprocess.PIPE, "text": True}
    return subprocess.run([str(word) for word in command], check=True, **given).stdout
