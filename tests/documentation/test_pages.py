"""Pages agree with the repository, the configuration and a run; generated parts are current."""

import csv
import re

import pytest
from tiny import TINY, composed

from bbq_torchrl.runs.train import run
from scripts import write_docs

from .pages import PAGES, ROOT

DOCS = ROOT / "docs"


def text_of(*names):
    return ROOT.joinpath(*names).read_text(encoding="utf-8")


def anchors(page):
    """The ids that the site gives to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    words = (re.sub(r"[^\w\s-]", "", heading).strip().lower() for heading in headings)
    return {re.sub(r"[\s-]+", "-", heading) for heading in words}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        name, _, anchor = target.partition("#")
        if "://" not in target:
            file = page.parent / name if name else page
            assert file.exists(), target
            assert not anchor or anchor in anchors(file), target


@pytest.mark.slow
def test_no_page_is_out_of_date():
    pages = [page.name for page in write_docs.outdated(write_docs.BLOCKS)]
    assert pages == [], "run python scripts/write_docs.py"


def test_every_block_is_on_a_page():
    text = "".join(page.read_text(encoding="utf-8") for page in write_docs.pages())
    marks = set(re.findall(r"<!-- begin: ([\w.]+) -->", text))
    assert marks == set(write_docs.BLOCKS)


def test_a_block_is_replaced_and_the_rest_is_kept():
    page = "before\n<!-- begin: a -->\nold\n<!-- end: a -->\nafter\n"
    filled = write_docs.rewrite(page, {"a": lambda: "new"})
    assert filled == "before\n<!-- begin: a -->\n\nnew\n\n<!-- end: a -->\nafter\n"
    assert write_docs.rewrite(filled, {"a": lambda: "new"}) == filled
    for bad in ("b -->\n<!-- end: b", "a -->\nold\n<!-- end: b"):
        with pytest.raises(ValueError, match=r"'b'|not closed"):
            write_docs.rewrite(f"<!-- begin: {bad} -->", {"a": lambda: "new"})


def test_the_site_has_every_page_and_searches_without_a_server():
    configuration = text_of("mkdocs.yml")
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    assert pages == set(re.findall(r": ([\w/]+\.md)$", configuration, re.MULTILINE))
    assert "\nuse_directory_urls: false\n" in configuration
    assert "\n  - offline\n" in configuration
    [script] = re.findall(r"polyfills:\n +- (\S*iframe-worker\S*)\n", configuration)
    assert "window.Worker=" in text_of("docs", script)


PAGE = (ROOT / "docs" / "quickstart.md").read_text(encoding="utf-8")


def first_cells(heading):
    """Returns the code in the first column of the first table under a heading."""
    section = PAGE.partition(f"\n{heading}\n")[2]
    table = section.partition("\n| ")[2].partition("\n\n")[0]
    cells = [line.strip("| ").split(" | ")[0] for line in table.splitlines()[2:]]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


CHOICES = (["explore=thompson_epsilon"], ["explore=boltzmann", "intrinsic=vime"])


@pytest.fixture(scope="module")
def run_folders(tmp_path_factory, without_curves):
    """The folders of tiny runs, which have every column there is."""
    folders = [tmp_path_factory.mktemp("run") for _ in CHOICES]
    for folder, chosen in zip(folders, CHOICES, strict=True):
        run(composed(*chosen, *TINY, "protocol.rounds=1"), folder)
    return folders


def test_every_column_is_explained(run_folders):
    files = [(folder / "metrics.csv").read_text(encoding="utf-8") for folder in run_folders]
    columns = {name for file in files for name in next(csv.reader(file.splitlines()))}
    assert columns == first_cells("### metrics.csv") - {"<group>.<key>"}


def test_every_file_is_explained(run_folders):
    documented = {name.rstrip("/") for name in first_cells("## The run folder")}
    made = {path.name for folder in run_folders for path in folder.iterdir()}
    # Hydra's own are there only in runs from the command line.
    assert documented - made == {".hydra", "train.log"}
    assert made <= documented
