"""The smaller examples run in their short form, and say and measure what they are there for."""

import copy
import re
import sys

import forked
import pytest
import torch
from extended import EXAMPLES, ROOT
from tiny import TINY, rows
from torch.testing import assert_close

from bbq_torchrl.evaluation.curves import read_metrics
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer

NOTEBOOK = EXAMPLES / "tutorial.ipynb"


@pytest.mark.parametrize(
    ("name", "frames", "said"),
    [
        ("cartpole_bbqn", "100", r"mean network, 20 episodes: return (\d+\.\d) of at most 500"),
        pytest.param(
            *("cartpole_vime", "300", r"mean return of the last 10 episodes: ([\d.]+)"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_cartpole_is_played_without_anything_of_dialogue(tmp_path, name, frames, said):
    script = EXAMPLES / f"{name}.py"
    rooms = set(re.findall(r"(?:from|import) bbq_torchrl\.(\w+)", script.read_text()))
    assert rooms <= {"bayes", "exploration", "networks", "objectives", "vime"}
    pytest.importorskip("gymnasium")
    out, err = forked.run_script(script, "--frames", frames, cwd=tmp_path)
    # The child ends at once, so that Python's own tracker may tell of what it leaves behind.
    warned = [line for line in err.splitlines() if "Warning" in line]
    assert all("resource_tracker" in line for line in warned), err
    line = re.fullmatch(said, out.splitlines()[-1])
    assert line is not None, out
    assert 1 <= float(line[1]) <= 500


def test_regression_saves_a_figure(tmp_path):
    out = tmp_path / "new" / "figure.png"
    script = EXAMPLES / "regression.py"
    text, _ = forked.run_script(script, "--steps", "20", "--out", str(out), cwd=tmp_path)
    assert re.search(r"spread of the draws off the data / on the data: \d+\.\d\n", text)
    assert out.read_bytes().startswith(b"\x89PNG")


def test_plateau_measures_the_values_of_the_last_actions_of_successes(names_of, tmp_path):
    example = names_of("plateau")
    trainer = example["spiked_trainer"]("kaiming", 0.1, 1, tmp_path)
    transitions = trainer.replay.buffers[0].storage[:]
    last = transitions["next", "reward"].squeeze(-1) == 40
    assert 0 < int(last.sum()) < 100
    network = trainer.policy.actor[0].module
    with torch.no_grad():
        values = network(transitions["observation"].unsqueeze(0), "mean")[0]
    expected = values[last].gather(-1, transitions["action"][last].unsqueeze(-1)).mean()
    assert example["values_of_successes"](trainer) == [pytest.approx(float(expected), abs=1e-4)]


@pytest.mark.slow
def test_plateau_writes_a_line_for_every_start_freeze_and_seed(names_of, tmp_path, monkeypatch):
    example, file = names_of("plateau"), tmp_path / "plateau.csv"
    monkeypatch.setattr(sys, "argv", ["plateau.py", "--epochs=1", "--seeds=2", f"--file={file}"])
    example["main"]()
    lines = rows(file)
    assert [(line["start"], line["seed"]) for line in lines] == [
        (start, seed) for start in example["STARTS"] for seed in ("0", "1")
    ]
    assert all(int(line["updates"]) > 50 for line in lines)


@pytest.mark.slow
def test_maskable_ppo_of_another_library_plays_dialogues(tmp_path):
    pytest.importorskip("sb3_contrib")
    short = ("--steps", "128", "--batch", "64", "--dialogues", "5")
    said, _ = forked.run_script(EXAMPLES / "maskable_ppo.py", *short, cwd=tmp_path)
    line = re.fullmatch(r"MaskablePPO, 128 turns: success rate (\d\.\d{3})\n", said)
    assert line is not None, said
    assert 0 <= float(line[1]) <= 1


@pytest.fixture
def notebook():
    return pytest.importorskip("nbformat").read(NOTEBOOK, as_version=4)


def test_the_notebook_is_kept_without_outputs(notebook):
    pytest.importorskip("nbformat").validate(notebook)
    assert NOTEBOOK.stat().st_size < 20_000
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell for cell in cells if cell.outputs or cell.execution_count is not None] == []


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom(notebook, monkeypatch, tmp_path):
    nbclient = pytest.importorskip("nbclient")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "TMPDIR"):
        monkeypatch.setenv(name, str(tmp_path))
    resources = {"metadata": {"path": tmp_path}}
    nbclient.NotebookClient(notebook, timeout=600, resources=resources).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    said = "".join(output.text for output in outputs if output.get("name") == "stdout")
    assert "round 1: " in said
    assert "policy: mean - rollout of batch size [1, 5, 20]" in said


TANDEM = (*TINY, "replicas=2")


@pytest.mark.slow
def test_an_agent_in_tandem_with_itself_learns_what_it_does_in_an_ordinary_run(names_of, tmp_path):
    example = names_of("tandem")
    active, passive = example["make_trainers"]("dqn", "dqn", TANDEM, tmp_path)
    begun = copy.deepcopy(active.learner.loss.state_dict())
    rows = [row for part in example["tandem"](active, passive) for row in part]

    config = compose([f"+experiment=[agents/dqn,{example['PROTOCOL']}]", *TANDEM])
    alone = build_trainer(config, tmp_path / "alone")[0].train()
    rates = [(row["round"] + 1, row["replica"], row["eval_success_rate"]) for row in alone]
    for role in ("active", "passive"):
        assert [row for row in rows if row[0] == role] == [(role, *rate) for rate in rates]
    watched = read_metrics(tmp_path / "active")
    for name in ("loss", "reward"):
        assert watched[name].ravel().tolist() == [row[name] for row in alone]
    learned = active.learner.loss.state_dict()
    assert_close(learned, passive.learner.loss.state_dict(), rtol=0, atol=0)
    assert any(not torch.equal(value, begun[key]) for key, value in learned.items())
