"""Files and functions that a training enters before its first gradient step."""

import json

import forked
import pytest

FILES = 60
FUNCTIONS = 450

COUNT = """
import json, sys
from pathlib import Path

# Not watched: of libraries no function counts, and watching their imports takes long.
import hydra, torch, torchrl.data, torchrl.envs, torchrl.modules, torchrl.objectives

root, folder = sys.argv[1:]
entered = {}


def note(frame, event, argument):
    if event == "call":
        entered[id(frame.f_code)] = frame.f_code


def is_ours(code):
    is_function = code.co_flags & 1 and not code.co_name.startswith("<")
    return is_function and code.co_filename.startswith(f"{root}/bbq_torchrl/")


def stop(*arguments, **options):
    sys.setprofile(None)
    ours = filter(is_ours, entered.values())
    print(json.dumps([(code.co_filename, code.co_firstlineno, code.co_name) for code in ours]))
    raise SystemExit


torch.Tensor.backward = stop
few = ("spike.dialogues=2", "protocol.dialogues=2")
sys.argv = ["train.py", "protocol=quick", *few, f"hydra.run.dir={folder}"]
sys.path.insert(0, root)
sys.setprofile(note)
import train

train.main()
"""


@pytest.mark.slow
def test_a_training_enters_few_files_and_functions_before_its_first_gradient_step(tmp_path):
    out, _ = forked.python("-c", COUNT, forked.ROOT, tmp_path / "run", cwd=tmp_path)
    entered = {tuple(place) for place in json.loads(out.splitlines()[-1])}
    files = {file for file, *_ in entered}
    assert len(files) <= FILES, sorted(files)
    assert len(entered) <= FUNCTIONS
    assert any(file.endswith("objectives/bbqn.py") for file in files)
