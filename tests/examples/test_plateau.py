"""The plateau example: what it measures, and that its file holds a line for each measurement."""

from __future__ import annotations

import sys

import pytest
import torch
from extended import EXAMPLES
from tiny import rows

SCRIPT = EXAMPLES / "plateau.py"


def test_the_values_are_those_of_the_last_actions_of_successes(example, tmp_path):
    trainer = example["spiked_trainer"]("kaiming", 0.1, 1, tmp_path)
    rows = trainer.replay.buffers[0].storage[:]
    last = rows["next", "reward"].squeeze(-1) == 40
    assert 0 < int(last.sum()) < 100
    network = trainer.policy.actor[0].module
    with torch.no_grad():
        values = network(rows["observation"].unsqueeze(0), "mean")[0]
    expected = values[last].gather(-1, rows["action"][last].unsqueeze(-1)).mean()
    assert example["values_of_successes"](trainer) == [pytest.approx(float(expected), abs=1e-4)]


def test_a_line_for_every_start_freeze_and_seed(example, tmp_path, monkeypatch):
    file = tmp_path / "plateau.csv"
    monkeypatch.setattr(sys, "argv", ["plateau.py", "--epochs=1", "--seeds=2", f"--file={file}"])
    example["main"]()
    lines = rows(file)
    assert [(line["start"], line["seed"]) for line in lines] == [
        (start, seed) for start in example["STARTS"] for seed in ("0", "1")
    ]
    assert all(int(line["updates"]) > 50 for line in lines)
