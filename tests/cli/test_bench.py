"""``bbq bench``: cells in order, the page and its data, what is missing, and equal bytes."""

import json
import math
import shutil
from argparse import Namespace

import forked
import numpy as np
import pytest
import torch
from tiny import TINY, rows, without_drawing

from bbq_torchrl.cli import bench
from bbq_torchrl.cli.evaluate import composed, evaluation
from bbq_torchrl.runs import train
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.utils.statistics import binomial_standard_error, pass_k

OWN = "own: agent=dqn explore=boltzmann"
KEYS = [
    *(
        key
        for key in TINY
        if not key.startswith(("protocol.rounds", "protocol.eval_every=", "domain"))
    ),
    "protocol.keep_checkpoints=weights",
    "protocol.eval_batch=200",
]


def run(folder, *agents, code=0):
    """Runs the command in a child. Returns what it printed."""
    chosen = ["--agents", *agents, "--domains", "hotel", "--errors", "0.1"]
    given = ["made", *chosen, "--budgets", "4", "12", "--seeds", "2", "--set", *KEYS]
    return forked.call(lambda: bench.main(given), cwd=folder, code=code)


@pytest.fixture(scope="module", autouse=True)
def quick():
    """A goal is played no more often than pass^8 needs, and figures are empty files."""
    for agent in ("agent=dqn", "+experiment=agents/dqn"):  # once, not in every child
        compose([agent]), compose([agent, "domain=hotel"])
    with without_drawing(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "PLAYS", 8)
        patch.setattr("bbq_torchrl.utils.reports.save", lambda figure, file: file.touch())
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    page, _ = run(folder, "dqn", OWN)
    return folder, page


def test_the_page_has_a_row_for_each_agent(made):
    folder, page = made
    assert "### hotel, errors 0.1" in page
    assert {"| dqn |", "| own |"} <= {line[:7] for line in page.splitlines()}
    assert "Missing" not in page
    assert (folder / "made" / "bench.md").read_text().startswith(page.rstrip("\n"))
    figures = [f"{name}.{kind}" for name in ("profiles", "booked") for kind in ("png", "svg")]
    names = {file.name for file in (folder / "made").iterdir()}
    assert {*figures, "bench.md", "bench.csv"} <= names


def test_a_row_says_what_the_run_folder_says(made):
    folder, _ = made
    table = rows(folder / "made" / "bench.csv")
    assert [(row["agent"], row["replica"]) for row in table] == [
        *(("dqn", "0"), ("dqn", "1"), ("own", "0"), ("own", "1"))
    ]
    cell = folder / "made" / "hotel" / "errors_0.1" / "own"
    result = json.loads((cell / "result.json").read_text())["per_replica"][1]
    rounds = [line for line in rows(cell / "metrics.csv") if line["replica"] == "1"]
    assert float(table[3]["success_after_12"]) == result["success_rate"]
    assert float(table[3]["reward"]) == result["reward"]
    assert float(table[3]["success_after_4"]) == float(rounds[0]["eval_success_rate"])
    booked = np.mean([float(line["success_rate"]) for line in rounds])
    assert float(table[3]["booked_after_12"]) == pytest.approx(booked)


def test_every_cell_has_a_command_a_commit_and_versions(made):
    folder, _ = made
    about = json.loads((folder / "made" / "bench.json").read_text())
    assert about["command"].startswith("bbq bench ")
    for cell in about["cells"]:
        assert "domain=hotel env.slot_error_prob=0.1" in cell["command"]
        assert {"torch", "torchrl"} <= cell["versions"].keys()
        assert {"commit", "clean"} <= cell.keys()


def test_a_cell_that_fails_is_named_and_leaves_the_others_alone(made, tmp_path, monkeypatch):
    def trained(config, folder):
        with (tmp_path / "trained").open("a") as file:
            file.write(f"{folder.name} ")
        raise torch.linalg.LinAlgError("the matrix is singular")

    shutil.copytree(made[0] / "made", tmp_path / "made")
    monkeypatch.setattr(train, "run", trained)
    agents = ("wild: agent=dqn", "wilder: agent=dqn", "dqn")
    for times in range(2):
        page, error = run(tmp_path, *agents, code=1)
        assert "**Missing:** wild on hotel, errors 0.1 (" in page
        assert error.count("LinAlgError: the matrix is singular)\n") == 2
        assert "No setting is finished by all agents." in page
        assert "| dqn |" in page
        assert "| wild |" not in page
        # Nothing is tried again but what is told to be.
        done = ["wild", "wilder", "wilder"][: 2 + times]
        assert (tmp_path / "trained").read_text().split() == done
        (tmp_path / "made" / "hotel" / "errors_0.1" / "wilder" / "failed.txt").unlink()


def test_a_seed_that_diverges_is_named_and_the_others_count(tmp_path):
    page, _ = run(tmp_path, "half: agent=dqn agent.lr=[.001,1e30]", code=1)
    assert "**Missing:** half on hotel, errors 0.1, replica 1 (diverged)." in page
    assert "No setting is finished by all agents." in page
    assert [row["replica"] for row in rows(tmp_path / "made" / "bench.csv")] == ["0"]


def test_a_page_alone_trains_nothing(tmp_path):
    page, _ = run(tmp_path, "dqn", "--page", code=1)
    assert "**Missing:** dqn on hotel, errors 0.1 (not trained)." in page
    assert not (tmp_path / "made" / "hotel").exists()


def test_goals_are_played_as_often_as_an_evaluation_plays_them(monkeypatch, tmp_path):
    # A scripted policy takes the place of a trained one; another command measures its success.
    given = Namespace(folder=tmp_path, errors=["reference"], budgets=[500], seeds=2, seed=1)
    (cell,) = bench.cells_of("dqn", ["agent=dqn"], {"hotel": ["domain=hotel"]}, given)
    env, domain = cell.config.env, cell.config.domain.make()

    def loaded(folder, *, dialogues, device):
        made = env.make(domain, (2, dialogues), device=device)
        return made, env.make_policy("careful", made)

    monkeypatch.setattr("bbq_torchrl.runs.loading.load_run", loaded)
    played = {key: np.array(value) for key, value in bench.goal_plays(cell).items()}
    assert played["plays"].shape == (2, len(domain.goals))
    assert (played["plays"].sum(-1) == bench.PLAYS * len(domain.goals)).all()
    known = evaluation(composed(["policy=careful", "domain=hotel", "dialogues=4000"]))
    found = pass_k(played["successes"].sum(0), played["plays"].sum(0), 1)
    error = binomial_standard_error(known["success_rate"], int(played["plays"].sum()))
    assert abs(found - known["success_rate"]) < 4 * math.hypot(error, known["standard_error"])
