"""Makes the examples importable: scripts that find one another, and a package with options."""

import functools
import re
import runpy
import sys

import pytest
from extended import EXAMPLES, PACKAGE
from own_options import own_options

sys.path.append(str(EXAMPLES / "deep_sea"))


@pytest.fixture(scope="session")
def names_of():
    """Runs an example, given without its ending, as a module: the names in it."""
    return functools.cache(lambda name: runpy.run_path(str(EXAMPLES / f"{name}.py")))


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The package as pip would have installed it: on the path, with its entry points."""
    site = tmp_path_factory.mktemp("site")
    points = re.findall(
        r'^\w+ = "bbq_extending\.\w+"', (PACKAGE / "pyproject.toml").read_text(), re.M
    )
    metadata = site / "bbq_extending-0.1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: bbq-extending\nVersion: 0.1.0\n"
    )
    lines = ["[bbq_torchrl.options]", *(point.replace('"', "") for point in points)]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n")
    with own_options(packages=True) as patch:
        for folder in (site, PACKAGE):
            patch.syspath_prepend(folder)
        yield
    for name in [name for name in sys.modules if name.startswith("bbq_extending")]:
        del sys.modules[name]  # its options register where it is imported
