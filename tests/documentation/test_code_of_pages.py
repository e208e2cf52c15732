"""The Python of the pages runs, their commands are accepted, and files that they print work."""

import re
import sys
from types import ModuleType

import forked
import pytest
from own_options import own_options

from bbq_torchrl.domains import load_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.options import EvaluateConfig
from bbq_torchrl.options.registry import conf_folder
from bbq_torchrl.people.language.corpus import make_examples
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import main as train
from bbq_torchrl.search.definition import compose_search

from .pages import PAGES, ROOT, commands, snippets

pytestmark = pytest.mark.slow

AGENT, DOMAIN, PARTS = (ROOT / f"docs/{name}.md" for name in ("your_agent", "your_domain", "parts"))
BAYESIAN = {"mean_init", "std_init", "noise_std", "kl_temperature"}


@pytest.mark.parametrize(
    "page", [page for page in PAGES if snippets(page, "python")], ids=lambda page: page.name
)
def test_python_of_a_page_runs_from_top_to_bottom(page, monkeypatch, capsys):
    module = ModuleType(page.stem)
    monkeypatch.setitem(sys.modules, page.stem, module)
    with own_options():  # a page's options are its own
        for text in snippets(page, "python"):
            exec(compile(text, str(page), "exec"), vars(module))
    if hasattr(module, "Parrot"):
        assert module.Parrot(None).reply("parrot", None, "bye", seed=0).ended
    if page == PARTS:
        (shown,) = (text for text in snippets(page, "text") if text.startswith("RMSE"))
        (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("RMSE"))
        assert figures(line) == pytest.approx(figures(shown), abs=0.03)


def figures(line):
    """RMSE and share of the page's regression."""
    rmse, share = re.search(r"RMSE (.+), truth .* at (.+)% of", line).groups()
    return float(rmse), float(share) / 100


def first(argument):
    """The first element of a sweep's list stands for all."""
    key, _, value = argument.partition("=")
    if value.startswith("range("):
        return f"{key}=0"
    if value == "glob(*)":
        files = (conf_folder() / key.removeprefix("+")).glob("*.yaml")
        return f"{key}={min(file.stem for file in files)}"
    return argument if value.startswith("[") else f"{key}={value.split(',')[0]}"


ACCEPTED = [
    *(pytest.param(compose, item, id=f"train {item}") for item in commands("python train.py")),
    *(
        pytest.param(lambda given: compose(given, EvaluateConfig), item, id=f"evaluate {item}")
        for item in commands("bbq evaluate")
    ),
    *(pytest.param(compose_search, item, id=f"search {item}") for item in commands("bbq search")),
]


@pytest.mark.parametrize(("accept", "arguments"), ACCEPTED)
def test_a_documented_command_is_accepted(accept, arguments, tmp_path):
    if {"--help", "--cfg"} & set(arguments) or arguments[0].startswith("resume="):
        pytest.skip("it composes nothing")
    given = [argument.replace("<folder>", str(tmp_path)) for argument in arguments]
    if "--multirun" in given:
        given = [first(argument) for argument in given]
    accept([item for item in given if not item.startswith(("--", "hydra"))])


def printed(page, language, start):
    """The code of a page that starts so."""
    (found,) = (text for text in snippets(page, language) if text.startswith(start))
    return found


def test_the_whole_loop_learns_by_the_defaults():
    pytest.importorskip("gymnasium")
    text = printed(PARTS, "python", "import torch\nfrom torchrl.collectors")
    assert not BAYESIAN & set(re.findall(r"\w+", text))
    for whole, smaller in {"frames=15_000": "frames=7_500", "range(20)": "range(5)"}.items():
        assert text.count(whole) == 1
        text = text.replace(whole, smaller)
    names = {}
    exec(compile(text, str(PARTS), "exec"), names)
    assert names["cartpole"](seed=0) >= 150  # it begins at 10


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


def test_the_loss_of_ones_own_is_an_option_of_a_folder(train_with):
    option = printed(AGENT, "python", '"""``agent=conservative``')
    loss = printed(AGENT, "python", '"""The TD error, and a penalty')
    files = {"conservative_loss.py": loss, "conservative.py": option}
    arguments = ("spike.dialogues=2", "env.max_turn=8", "replicas=2")
    train_with(files, *arguments, agent="conservative")


def test_the_gymnasium_environment_is_an_option_of_a_folder(train_with):
    pytest.importorskip("gymnasium")
    option = printed(AGENT, "python", '"""``env=cartpole``')
    train_with({"cartpole.py": option}, "env=cartpole", "env.length=10", "spike=none")


def test_the_whole_domain_is_loaded_and_played(tmp_path):
    for name, language, start in (
        ("domain.yaml", "yaml", "name: lunch"),
        ("knowledge_base.csv", "csv", "food,"),
        ("goals.jsonl", "json", '{"constraints"'),
        ("values.json", "json", '{"food"'),
    ):
        (tmp_path / name).write_text(printed(DOMAIN, language, start))
    domain = load_domain(tmp_path)
    assert len(make_examples(Lexicon(domain), 100, seed=0)) == 100  # to learn what is said
    env = DialogueEnv(domain, batch_size=(50,), seed=0)
    for policy in ("rule", "careful"):
        rollout = env.rollout(20, scripted_policy(policy, env), break_when_any_done=False)
        assert rollout["next", "success"].any()
