"""Makes the examples importable: scripts that find one another, and a package with options."""

import functools
import importlib
import re
import runpy
import sys

import pytest
from extended import EXAMPLES, PACKAGE
from own_options import own_options

PYPROJECT = PACKAGE / "pyproject.toml"
sys.path.append(str(EXAMPLES / "deep_sea"))


@pytest.fixture(scope="session")
def names_of():
    """Runs an example, given without its ending, as a module: the names in it."""
    return functools.cache(lambda name: runpy.run_path(str(EXAMPLES / f"{name}.py")))


@pytest.fixture(scope="module")
def installed():
    """The package on the path, with the options that its entry points name."""
    points = re.findall(r'^\w+ = "(bbq_extending\.\w+)"', PYPROJECT.read_text(), re.M)
    with own_options() as patch:
        patch.syspath_prepend(PACKAGE)
        for name in points:
            importlib.import_module(name)
        yield
    for name in [name for name in sys.modules if name.startswith("bbq_extending")]:
        del sys.modules[name]  # its options register where it is imported
