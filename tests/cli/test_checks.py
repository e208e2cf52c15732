"""What depends on the machine and the domain is checked before anything runs."""

from __future__ import annotations

import logging
import re
import shutil

import pytest
from tiny import TINY

from bbq_torchrl.cli.checks import check
from bbq_torchrl.cli.store import compose
from bbq_torchrl.extras import install_command
from bbq_torchrl.options import ConfigError
from bbq_torchrl.run import run


def test_a_logger_whose_package_is_missing_is_refused_with_the_way_to_it(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name, package=None: None)
    message = f"logger=mlflow needs the package mlflow: {install_command('mlflow')}"
    with pytest.raises(ConfigError, match=re.escape(message)):
        check(compose(["logger=mlflow"]))


def test_a_buffer_may_have_room_for_one_more_than_the_spike():
    check(compose(["spike.dialogues=100", "protocol.capacity=801"]))  # a rule dialogue has 8 turns


@pytest.fixture
def where(restaurant_folder, tmp_path):
    """A domain whose rule needs a slot that comes later."""
    folder = shutil.copytree(restaurant_folder, tmp_path / "domain")
    file = folder / "domain.yaml"
    script = "steps: [request(cuisine), "
    file.write_text(file.read_text().replace(script, f"{script}request(price_range), "))
    return "domain=folder", f"domain.path={folder}"


def test_a_result_says_which_policy_it_lacks_whose_slot_has_not_come(where, tmp_path, caplog):
    config = compose([*TINY, *where, "env=domain_ext", "spike.policy=careful", "protocol.rounds=1"])
    with caplog.at_level(logging.WARNING):
        result = run(config, tmp_path / "run")
    assert {"careful", "random"} <= result.scripted.keys()
    assert "rule" not in result.scripted
    assert any("left out of the result: policy rule" in told for told in caplog.messages)
