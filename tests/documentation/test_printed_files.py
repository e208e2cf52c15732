"""Files that the pages print, saved as the pages say, work as they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import forked
import pytest

from bbq_torchrl.cli.train import main as train
from bbq_torchrl.domains import load_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy

from .pages import ROOT, snippets

if TYPE_CHECKING:
    from pathlib import Path

OPTIONS, ENVIRONMENT = (ROOT / "docs" / f"{name}.md" for name in ("options", "environment"))

SHRUNKEN = (
    "protocol.rounds=1",
    "protocol.dialogues=2",
    "protocol.batch_size=8",
    "protocol.capacity=100",
    "protocol.eval_dialogues=2",
    "protocol.eval_every=0",
    "agent.hidden=[8]",
)


def _printed(page: Path, language: str, start: str) -> str:
    """Returns the code of a page that starts so."""
    (found,) = (text for text in snippets(page, language) if text.startswith(start))
    return found


def _train(*arguments: str, cwd: Path) -> None:
    given = ("--config-dir", "my_options", "agent=bbqn", *arguments, "hydra.run.dir=run", *SHRUNKEN)
    forked.call(train, *given, cwd=cwd)
    assert (cwd / "run" / "result.json").is_file()


@pytest.fixture
def my_options(tmp_path: Path) -> Path:
    folder = tmp_path / "my_options"
    folder.mkdir()
    return folder


def test_the_strategy_of_two_files_is_an_option_of_a_folder(my_options: Path) -> None:
    changed = "from ucb_policy import UpperConfidence"
    assert f"with `{changed}`" in OPTIONS.read_text(encoding="utf-8")
    option = _printed(OPTIONS, "python", '"""``explore=ucb``')
    own = "from bbq_extending.ucb_policy import UpperConfidence"
    assert own in option
    (my_options / "ucb.py").write_text(option.replace(own, changed))
    policy = _printed(OPTIONS, "python", '"""An upper confidence bound')
    (my_options / "ucb_policy.py").write_text(policy)
    _train("explore=ucb", "spike.dialogues=2", "env.max_turn=8", cwd=my_options.parent)


def test_the_gymnasium_environment_is_an_option_of_a_folder(my_options: Path) -> None:
    pytest.importorskip("gymnasium")
    option = _printed(OPTIONS, "python", '"""``env=cartpole``')
    (my_options / "cartpole.py").write_text(option)
    _train("env=cartpole", "env.length=10", "spike=none", cwd=my_options.parent)


def test_the_whole_domain_is_loaded_and_played(tmp_path: Path) -> None:
    files = {
        "domain.yaml": _printed(ENVIRONMENT, "yaml", "name: lunch"),
        "knowledge_base.csv": _printed(ENVIRONMENT, "csv", "food,"),
        "goals.jsonl": _printed(ENVIRONMENT, "json", '{"constraints"'),
        "values.json": _printed(ENVIRONMENT, "json", '{"food"'),
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    env = DialogueEnv(load_domain(tmp_path), batch_size=(50,), seed=0)
    for policy in ("rule", "careful"):
        rollout = env.rollout(20, scripted_policy(policy, env), break_when_any_done=False)
        assert rollout["next", "success"].any()
