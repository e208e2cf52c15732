"""Old import paths: each hands over what is now elsewhere, and warns."""

from __future__ import annotations

from importlib import import_module

import pytest

from bbq_torchrl.renamed import RENAMED


@pytest.mark.parametrize("old", RENAMED)
def test_an_old_path_has_the_names_of_the_new_one_and_warns(old):
    new = import_module(f"bbq_torchrl.{RENAMED[old]}")
    name = next(name for name in vars(new) if not name.startswith("_"))
    with pytest.warns(DeprecationWarning, match=f"bbq_torchrl.{old} is now {new.__name__}"):
        assert getattr(import_module(f"bbq_torchrl.{old}"), name) is getattr(new, name)


def test_an_old_path_lacks_what_the_new_one_lacks():
    with (
        pytest.warns(DeprecationWarning, match="is now bbq_torchrl.options.agent"),
        pytest.raises(ImportError, match="cannot import name 'Unknown'"),
    ):
        from bbq_torchrl.options.agent.dqn import Unknown  # noqa: F401
