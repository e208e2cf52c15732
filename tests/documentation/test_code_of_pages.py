"""The Python of the pages runs, their commands are accepted, and files that they print work."""

from __future__ import annotations

import re
import sys
from types import ModuleType

import forked
import pytest
import torch
from own_options import own_options
from tensordict import TensorDict
from torchrl.data import Categorical
from torchrl.envs.utils import check_env_specs

from bbq_torchrl.domains import load_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import OneStepQLoss
from bbq_torchrl.options import EvaluateConfig
from bbq_torchrl.options.registry import conf_folder
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import main as train
from bbq_torchrl.search.definition import compose_search

from .pages import PAGES, ROOT, commands, snippets

WITH_PYTHON = [page for page in PAGES if snippets(page, "python")]


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.name)
def test_python_of_a_page_runs_from_top_to_bottom(page, monkeypatch):
    module = ModuleType(page.stem)
    monkeypatch.setitem(sys.modules, page.stem, module)
    with own_options():  # a page's options are its own
        for text in snippets(page, "python"):
            exec(compile(text, str(page), "exec"), vars(module))


def is_composed(arguments):
    """Whether a training stands for a configuration by itself: no help, no resumed run."""
    shows_help = bool({"--help", "--cfg"} & set(arguments))
    return not shows_help and not any(item.startswith("resume=") for item in arguments)


def telling(kind, found, *alike):
    """The commands with a word that none before has; any value will do for some keys."""
    known = set()
    for page, arguments in found:
        words = {item for item in arguments if item.partition("=")[0] not in alike}
        if words - known:
            yield pytest.param(kind, arguments, id=f"{kind} {page} {arguments}")
            known |= words


TRAININGS = [item for item in commands("python train.py") if is_composed(item[1])]
EVALUATIONS = commands("bbq evaluate")
SEARCHES = commands("python -m bbq_torchrl.search")


def test_the_documentation_shows_python_trainings_and_evaluations():
    assert {"README.md", "parts.md"} <= {page.name for page in WITH_PYTHON}
    assert len(TRAININGS) >= 10
    assert len(EVALUATIONS) >= 3


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        *telling("train", TRAININGS, "seed", "replicas", "threads", "hydra.run.dir"),
        *telling("evaluate", EVALUATIONS, "policy", "dialogues", "batch", "log"),
        *telling("search", SEARCHES),
    ],
)
def test_a_documented_command_is_accepted(kind, arguments, tmp_path):
    given = [argument.replace("<folder>", str(tmp_path)) for argument in arguments]
    given = [argument for argument in given if not argument.startswith("--")]
    if kind == "evaluate":
        compose(given, EvaluateConfig)
    elif kind == "search":
        compose_search([argument for argument in given if argument != "&"])
    else:
        if "--multirun" in arguments:
            # Of every list of a sweep the first element stands for all.
            given = [first(argument) for argument in given]
        compose([argument for argument in given if not argument.startswith("hydra")])


def first(argument):
    key, _, value = argument.partition("=")
    if value.startswith("range("):
        return f"{key}=0"
    if value == "glob(*)":
        files = (conf_folder() / key.removeprefix("+")).glob("*.yaml")
        return f"{key}={min(file.stem for file in files)}"
    return f"{key}={value.split(',')[0]}"


OPTIONS, DOMAINS, PARTS = (ROOT / "docs" / f"{name}.md" for name in ("options", "domains", "parts"))


def printed(page, language, start):
    """The code of a page that starts so."""
    (found,) = (text for text in snippets(page, language) if text.startswith(start))
    return found


@pytest.fixture
def whole_loops():
    """The functions of the loops on the page of parts, which leave the Bayesian parts' defaults."""
    pytest.importorskip("gymnasium")
    names = {}
    for start in ("import torch\nfrom torchrl.collectors", "from tensordict import TensorDict\n"):
        text = printed(PARTS, "python", start)
        assert not {"prior_std", "mean_init", "std_init", "noise_std", "kl_temperature"} & set(
            re.findall(r"\w+", text)
        )
        exec(compile(text, str(PARTS), "exec"), names)
    return names


def test_the_game_of_the_page_keeps_torchrls_conventions(whole_loops):
    check_env_specs(whole_loops["Catch"](4))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("game", "least"), [("cartpole", 150), ("catch", 0.9)])
def test_a_whole_loop_learns_by_the_defaults(whole_loops, game, least, seed):
    assert whole_loops[game](seed) >= least


@pytest.fixture
def train_with(tmp_path):
    """Trains for a round with options of a folder, given as file name and text."""
    shrunken = ("rounds=1", "dialogues=2", "batch_size=8", "capacity=100", "eval_dialogues=2")

    def trained(files, *arguments, agent="bbqn"):
        folder = tmp_path / "my_options"
        folder.mkdir()
        for name, text in files.items():
            (folder / name).write_text(text)
        protocol = [f"protocol.{item}" for item in (*shrunken, "eval_every=0")]
        given = ("--config-dir", "my_options", f"agent={agent}", "agent.hidden=[8]", *arguments)
        forked.call(train, *given, *protocol, "hydra.run.dir=run", cwd=tmp_path)
        assert (tmp_path / "run" / "result.json").is_file()

    return trained


def test_the_strategy_of_two_files_is_an_option_of_a_folder(train_with):
    changed = "from ucb_policy import UpperConfidence"
    assert f"with `{changed}`" in OPTIONS.read_text(encoding="utf-8")
    option = printed(OPTIONS, "python", '"""``explore=ucb``')
    own = "from bbq_extending.ucb_policy import UpperConfidence"
    assert own in option
    policy = printed(OPTIONS, "python", '"""An upper confidence bound')
    files = {"ucb.py": option.replace(own, changed), "ucb_policy.py": policy}
    train_with(files, "explore=ucb", "spike.dialogues=2", "env.max_turn=8")


LOSS = printed(OPTIONS, "python", '"""The TD error, and a penalty')


def test_the_loss_of_ones_own_is_an_option_of_a_folder(train_with):
    option = printed(OPTIONS, "python", '"""``agent=conservative``')
    files = {"conservative_loss.py": LOSS, "conservative.py": option}
    arguments = ("spike.dialogues=2", "env.max_turn=8", "replicas=2")
    train_with(files, *arguments, agent="conservative")


def test_the_loss_of_ones_own_adds_its_penalty_for_each_replica():
    own = {"__name__": "conservative_loss"}
    exec(LOSS, own)
    actor = q_actor(FlatMLP(3, 4, [8], replicas=2), Categorical(4))
    rows = torch.Size([2, 5])
    end = {"reward": torch.rand(*rows, 1), "terminated": torch.rand(*rows, 1) < 0.5}
    state = {"observation": torch.rand(*rows, 3), "action_mask": torch.rand(*rows, 4) < 0.5}
    state["action_mask"][..., 0] = True
    other = {**state, "observation": torch.rand(*rows, 3)}
    data = {**state, "action": torch.zeros(rows, dtype=torch.long), "next": {**other, **end}}
    batch = TensorDict({**data, "valid": torch.arange(5).expand(rows) < 3}, rows)

    def losses(kind, **settings):
        return kind(actor, delay_value=False, **settings)(batch)

    without, with_it = (losses(own["ConservativeLoss"], alpha=alpha) for alpha in (0.0, 2.0))

    values = actor(batch.clone())["action_value"].where(batch["action_mask"], -torch.inf)
    gap = (values.logsumexp(-1) - values[..., 0])[:, :3].mean(-1)
    torch.testing.assert_close(with_it["loss_value"] - without["loss_value"], 2 * gap.detach())
    torch.testing.assert_close(with_it["loss"] - without["loss"], 2 * gap.sum())
    torch.testing.assert_close(without["loss"], losses(OneStepQLoss)["loss"])


def test_the_gymnasium_environment_is_an_option_of_a_folder(train_with):
    pytest.importorskip("gymnasium")
    option = printed(OPTIONS, "python", '"""``env=cartpole``')
    train_with({"cartpole.py": option}, "env=cartpole", "env.length=10", "spike=none")


def test_the_whole_domain_is_loaded_and_played(tmp_path):
    for name, language, start in (
        ("domain.yaml", "yaml", "name: lunch"),
        ("knowledge_base.csv", "csv", "food,"),
        ("goals.jsonl", "json", '{"constraints"'),
        ("values.json", "json", '{"food"'),
    ):
        (tmp_path / name).write_text(printed(DOMAINS, language, start))
    env = DialogueEnv(load_domain(tmp_path), batch_size=(50,), seed=0)
    for policy in ("rule", "careful"):
        rollout = env.rollout(20, scripted_policy(policy, env), break_when_any_done=False)
        assert rollout["next", "success"].any()
