"""The documentation explains every column and every file that a run leaves."""

import csv
import re

import pytest
from tiny import TINY

from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import run

from .pages import ROOT

PAGE = (ROOT / "docs" / "quickstart.md").read_text(encoding="utf-8")


def first_cells(heading):
    """Returns the code in the first column of the first table under a heading."""
    section = PAGE.partition(f"\n{heading}\n")[2]
    table = section.partition("\n| ")[2].partition("\n\n")[0]
    cells = [line.strip("| ").split(" | ")[0] for line in table.splitlines()[2:]]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


CHOICES = (["explore=thompson_epsilon"], ["explore=boltzmann", "intrinsic=vime"])
OF_A_CHOICE = {
    "epsilon",
    "temperature",
    "intrinsic_reward",
    "dynamics_loss",
    "dynamics_kl",
    "<group>.<key>",
}


@pytest.fixture(scope="module", params=CHOICES, ids=" ".join)
def run_folder(request, tmp_path_factory, without_curves):
    """The folder of a tiny run; between them, the two have every column there is."""
    folder = tmp_path_factory.mktemp("run")
    run(compose([*request.param, *TINY, "protocol.rounds=1"]), folder)
    return folder


def test_every_column_is_explained(run_folder):
    with (run_folder / "metrics.csv").open(encoding="utf-8") as file:
        columns = set(next(csv.reader(file)))
    documented = first_cells("### metrics.csv")
    assert columns <= documented
    assert documented - columns <= OF_A_CHOICE


def test_every_file_is_explained(run_folder):
    documented = {name.rstrip("/") for name in first_cells("## The run folder")}
    assert {path.name for path in run_folder.iterdir()} <= documented
    # Hydra's own are there only in runs from the command line.
    assert documented - {path.name for path in run_folder.iterdir()} == {".hydra", "train.log"}
