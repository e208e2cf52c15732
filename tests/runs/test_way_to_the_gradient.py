"""Files and functions that a training enters before its first gradient step."""

import json
import re

import forked

FILES = 85
FUNCTIONS = 520

COUNT = """
import json, sys
from pathlib import Path

import torch

root, folder = sys.argv[1:]
entered = set()


def note(frame, event, argument):
    code = frame.f_code
    is_function = code.co_flags & 1 and not code.co_name.startswith("<")
    if event == "call" and is_function and code.co_filename.startswith(f"{root}/bbq_torchrl/"):
        entered.add((code.co_filename, code.co_firstlineno, code.co_name))


def stop(*arguments, **options):
    sys.setprofile(None)
    print(json.dumps(sorted(entered)))
    raise SystemExit


torch.Tensor.backward = stop
sys.argv = ["train.py", "protocol=quick", f"hydra.run.dir={folder}"]
sys.path.insert(0, root)
sys.setprofile(note)
import train

train.main()
"""


def test_a_training_enters_few_files_and_functions_before_its_first_gradient_step(tmp_path):
    out, _ = forked.python("-c", COUNT, forked.ROOT, tmp_path / "run", cwd=tmp_path)
    entered = json.loads(out.splitlines()[-1])
    files = {file for file, *_ in entered}
    assert len(files) <= FILES, sorted(files)
    assert len(entered) <= FUNCTIONS
    assert any(file.endswith("objectives/bbqn.py") for file in files)


def test_the_main_job_is_read_in_twenty_files():
    page = (forked.ROOT / "docs" / "how_it_works.md").read_text(encoding="utf-8")
    _, _, rest = page.partition("### From train.py to the gradient step\n")
    files = re.findall(r"^\| `(\S+\.py)` \|", rest.partition("\n### ")[0], flags=re.MULTILINE)
    lines = [(forked.ROOT / file).read_text(encoding="utf-8").count("\n") for file in files]
    assert files[:2] == ["train.py", "bbq_torchrl/runs/train.py"]
    assert len(files) <= 20
    assert sum(lines) <= 3_500
