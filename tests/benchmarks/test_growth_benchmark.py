"""Growth is measured cell by cell, and goes on where it was stopped."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from bbq_torchrl.domains import Domain, tensorize
from benchmarks import growth
from benchmarks.parts import cells
from scripts.docs_blocks.growth import slope

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of cells; measuring notes the size as seconds."""

    def measure(what: str, size: int, clock: str) -> growth.Line:
        return {"what": what, "size": size, "seconds": float(size), "megabytes": 1.0}

    monkeypatch.setattr(growth, "measure", measure)
    return tmp_path / "growth.csv"


def test_goes_on_with_the_cells_that_are_missing(file: Path) -> None:
    first, second, *others = cells.GROWTH["replicas"][1]
    known = {"what": "replicas", "size": first, "seconds": 7.0, "megabytes": 2.0}
    growth.write(file, [known])
    growth.main(["replicas", f"--file={file}"])
    seconds = {line["size"]: line["seconds"] for line in growth.read(file)}
    assert seconds == {first: 7.0, **{size: float(size) for size in (second, *others)}}


def test_measures_again_what_is_asked_for_fresh(file: Path) -> None:
    first = cells.GROWTH["replicas"][1][0]
    lines = [
        {"what": what, "size": first, "seconds": 7.0, "megabytes": 2.0}
        for what in ("replicas", "rounds")
    ]
    growth.write(file, lines)
    growth.main(["replicas", "--fresh", f"--file={file}"])
    kept = {(line["what"], line["size"]): line["seconds"] for line in growth.read(file)}
    assert kept["rounds", first] == 7.0
    assert kept["replicas", first] == float(first)


def test_records_are_mixed_from_the_domains_own(movie: Domain) -> None:
    domain = cells.varied(movie, 150)
    assert len(domain.records) == 150
    values = {(slot, text) for record in movie.records for slot, text in record.items()}
    assert {(slot, text) for record in domain.records for slot, text in record.items()} <= values
    assert tensorize(domain).n_values.tolist() == tensorize(movie).n_values.tolist()


def test_new_values_make_the_vocabulary_grow(movie: Domain) -> None:
    domain = cells.varied(movie, 100, new_every=10)
    more = tensorize(domain).n_values - tensorize(movie).n_values
    assert more.sum() == 10
    assert more[movie.slots.index("theater")] == 10


def test_slope_of_a_square_is_two() -> None:
    assert slope([10, 20, 40], [100.0, 400.0, 1600.0]) == pytest.approx(2.0)
