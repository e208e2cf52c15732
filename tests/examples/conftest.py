"""Makes the examples importable: scripts that find one another, and a package with options."""

import functools
import re
import runpy
import sys
from importlib.metadata import EntryPoint

import pytest
from extended import EXAMPLES, PACKAGE
from own_options import own_options

from bbq_torchrl.options import registry

PYPROJECT = PACKAGE / "pyproject.toml"
sys.path.append(str(EXAMPLES / "deep_sea"))


@pytest.fixture(scope="session")
def names_of():
    """Runs an example, given without its ending, as a module: the names in it."""
    return functools.cache(lambda name: runpy.run_path(str(EXAMPLES / f"{name}.py")))


@pytest.fixture(scope="module")
def installed():
    """The package on the path, with the options that its entry points name."""
    found = re.findall(r'^(\w+) = "(bbq_extending\.\w+)"', PYPROJECT.read_text(), re.M)
    points = [EntryPoint(*point, registry.ENTRY_POINTS) for point in found]
    with own_options() as patch:
        patch.syspath_prepend(PACKAGE)
        patch.setattr(registry, "entry_points", lambda group: points)
        patch.setattr(registry, "_loaded", set())
        yield
    for name in [name for name in sys.modules if name.startswith("bbq_extending")]:
        del sys.modules[name]  # its options register where it is imported
