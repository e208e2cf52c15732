"""The registry of options: accepted options, and refusals of others."""

import sys
from dataclasses import make_dataclass
from importlib.metadata import EntryPoint

import forked
import pytest
from own_options import own_options
from tiny import TINY

from bbq_torchrl import load_run
from bbq_torchrl.options import ExploreOption, agreement, explorations, register, registry, root
from bbq_torchrl.options.registry import options
from bbq_torchrl.runs.compose import compose, take_config_dir, train_command
from bbq_torchrl.runs.train import main as train_main, make_agent
from bbq_torchrl.settings import COUNT, ConfigError, option, setting
from scripts import write_docs

STRATEGY = """
from dataclasses import dataclass
from typing import ClassVar

from bbq_torchrl.options import ExploreOption, register
from bbq_torchrl.settings import COUNT, option, setting


@register
@dataclass
class Narrow(ExploreOption):
    \"\"\"Greedy, and patient.\"\"\"

    name: str = option("narrow")
    patience: int = setting(3, COUNT, "rounds, $5 each")

    requires: ClassVar[tuple[str, ...]] = ("posterior",)

    def make(self, actor, greedy, task):
        return greedy, {"patience": lambda: self.patience}
"""


@pytest.fixture(autouse=True)
def unchanged(monkeypatch, tmp_path):
    """Removes what a test registers or loads."""
    monkeypatch.setenv(registry.FOLDER_VARIABLE, "")  # so that it is restored
    monkeypatch.delenv(registry.FOLDER_VARIABLE)
    with own_options():
        yield
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.fixture
def own(tmp_path):
    """Makes a folder with a user's option."""

    def folder(name="own"):
        (tmp_path / name / "explore").mkdir(parents=True)
        (tmp_path / name / "narrow_option.py").write_text(STRATEGY)
        return tmp_path / name

    return folder


def load(folder, *rest):
    return take_config_dir(["--config-dir", str(folder), *rest])


def of(base, class_name, **values):
    fields = [(key, object, value) for key, value in values.items()]
    return make_dataclass(class_name, fields, bases=(base,))


@pytest.mark.parametrize(
    "given",
    [
        type("Bare", (ExploreOption,), {"name": option("bare")}),  # no dataclass
        of(ExploreOption, "Plain", name="plain"),
        of(object, "Alone", name=option("alone")),
        of(ExploreOption, "Vague", name=option("vague"), patience=3),
        of(ExploreOption, "None", patience=setting(3, COUNT, "rounds")),
        of(ExploreOption, "Mine", name=option("thompson")),
    ],
)
def test_what_is_no_option_is_refused(given):
    with pytest.raises(TypeError):
        register(given)


def test_a_class_can_be_registered_again():
    ours = registry.schemas()["explore"]["thompson"]
    assert register(ours) is ours


def test_the_file_of_each_option_is_written_from_its_class():
    assert write_docs.outdated_options() == {}, "run python scripts/write_docs.py"


def test_two_options_agree_by_a_function_of_the_whole_configuration(monkeypatch):
    monkeypatch.setattr(root, "_AGREEMENTS", dict(root._AGREEMENTS))

    @agreement
    def never_two(config):
        if config.replicas == 2:
            raise ConfigError("replicas")

    compose(["agent=dqn", "replicas=3"])
    with pytest.raises(ConfigError, match=r"^replicas$"):
        compose(["agent=dqn", "replicas=2"])


def test_an_option_of_a_folder_is_checked_and_paired_like_ours(own):
    rest = load(own(), "explore=narrow", "explore.patience=5")

    assert rest == ["explore=narrow", "explore.patience=5"]
    assert compose(rest).explore.patience == 5
    assert "narrow" in options("explore")
    assert "narrow" in explorations()["bbqn"]
    for command, key in {
        "explore=narrow explore.patience=0": "explore.patience",
        "explore=narrow explore.patiance=2": "explore.patiance",
        "explore=narow": "explore/narow",
        "agent=dqn explore=narrow": "explore",
    }.items():
        with pytest.raises(ConfigError, match=key):
            compose(command.split())


@pytest.mark.parametrize("name", ["own", "o'b"])
def test_a_yaml_file_of_a_folder_is_an_option_with_other_defaults(name, own, tmp_path):
    text = "defaults: [narrow, _self_]\npatience: 9\n"
    (own(name) / "explore" / "patient.yaml").write_text(text)
    load(tmp_path / name)
    config = compose(["explore=patient"])
    assert (config.explore.name, config.explore.patience) == ("narrow", 9)
    assert "patient" in options("explore")


def test_the_folder_is_part_of_the_commands_that_are_told(own):
    assert train_command() == ["python", "train.py"]
    folder = own("own folder")
    load(folder)
    assert train_command() == ["python", "train.py", "--config-dir", str(folder)]


def test_a_run_with_an_option_of_a_folder_is_loaded_with_the_folder(own, tmp_path):
    folder = own()
    given = ("--config-dir", str(folder), "explore=narrow", "hydra.run.dir=run", *TINY)
    forked.call(train_main, *given, cwd=tmp_path)  # this process never saw the folder

    with pytest.raises(ConfigError, match="with --config-dir"):
        load_run(tmp_path / "run")
    with pytest.raises(ConfigError, match="options"):
        load_run(tmp_path / "run", options="nowhere")
    assert load_run(tmp_path / "run", options=folder).config.explore.patience == 3


def test_a_strategy_that_writes_no_action_is_refused_by_its_name(own):
    text = STRATEGY.replace("greedy, {", "TensorDictModule(abs, ['reward'], ['guess']), {")
    folder = own()
    (folder / "narrow_option.py").write_text(f"from tensordict.nn import TensorDictModule{text}")
    config = compose(load(folder, "explore=narrow", *TINY))
    with pytest.raises(ConfigError, match=r"explore=narrow .*guess"):
        make_agent(config, config.env.make(config.domain.make(), (1, 2)))


def test_a_package_that_cannot_be_imported_is_named(monkeypatch):
    ailing = EntryPoint("ill", "ailing.ill", registry.ENTRY_POINTS)
    monkeypatch.setattr(registry, "entry_points", lambda group: [ailing])
    monkeypatch.setattr(registry, "_loaded", set())
    with pytest.raises(ConfigError, match="ailing"):
        registry.schemas()
