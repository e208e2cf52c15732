"""A training from Python: twice in a process, beside another Hydra, refused by exceptions."""

import json
import logging
import os
import signal
import sys

import forked
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from tiny import TINY

import bbq_torchrl
from bbq_torchrl.settings import ConfigError

pytestmark = pytest.mark.usefixtures("without_curves")


def of_the_process():
    """The global state that a training must leave as it was."""
    return {
        "signals": [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)],
        "arguments": list(sys.argv),
        "handlers": list(logging.getLogger().handlers),
        "level": logging.getLogger().level,
        "folder": os.getcwd(),
        "threads": torch.get_num_threads(),
        "random": torch.get_rng_state().tolist(),
        "hydra": GlobalHydra.instance().hydra,
    }


def test_two_trainings_in_a_program_that_uses_hydra_leave_it_as_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "own"
    own.mkdir()
    (own / "program.yaml").write_text("lines: 3\n")
    with initialize_config_dir(str(own), version_base="1.3"):
        before = of_the_process()
        assert before["hydra"] is not None
        runs = [
            bbq_torchrl.train([*TINY, "protocol.rounds=1", f"agent={agent}"])
            for agent in ("dqn", "bbqn")
        ]
        assert of_the_process() == before
        assert compose("program").lines == 3

    for (folder, result), agent in zip(runs, ("dqn", "bbqn"), strict=True):
        assert folder.is_relative_to(tmp_path / "runs")
        written = json.loads((folder / "result.json").read_text())
        assert (written["agent"], written["success_rate"]) == (agent, result.success_rate)
        assert bbq_torchrl.load_run(folder).config.agent.name == agent
    again, result = bbq_torchrl.train([f"resume={folder}", "protocol.rounds=2"])
    assert (again, result.rounds) == (folder, 2)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["agent=dqm"], "agent/dqm"),
        (["--multirun", "seed=0,1"], "--multirun"),
        (["hydra.mode=MULTIRUN", "seed=0"], "--multirun"),
    ],
)
def test_what_cannot_be_run_is_an_exception_and_leaves_no_folder(
    overrides, message, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    before = of_the_process()
    with pytest.raises(ConfigError, match=message):
        bbq_torchrl.train(overrides)
    assert of_the_process() == before
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_importing_the_package_leaves_the_process_as_it_was(tmp_path):
    program = (
        "import os, signal, sys, warnings; "
        "state = lambda: ([signal.getsignal(n) for n in (2, 15)], dict(os.environ), sys.argv); "
        "before = state(); import bbq_torchrl; assert state() == before; "
        "assert not {'torch', 'hydra'} & sys.modules.keys()"
    )
    forked.python("-W", "error", "-c", program, cwd=tmp_path)
