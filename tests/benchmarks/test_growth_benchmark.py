"""Growth is measured cell by cell, each in the place of the last figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.domains import Domain, tensorize
from benchmarks import growth

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_cells_take_the_place_of_earlier_ones_in_the_order_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "growth.csv"
    first, *others = growth.GROWTH["replicas"][1]
    for what in ("new_values", "replicas", "rounds"):
        growth.keep(file, (what, first, 7.0, 2.0))
    monkeypatch.setattr(growth, "measure", lambda what, size: (float(size), 1.0))
    growth.main(["replicas", f"--file={file}"])
    head, *lines = file.read_text().splitlines()
    assert head == "what,size,seconds,megabytes"
    sizes = [f"replicas,{size},{float(size)},1.0" for size in (first, *others)]
    assert lines == [f"rounds,{first},7.0,2.0", *sizes, f"new_values,{first},7.0,2.0"]


def test_records_are_mixed_from_the_domains_own(movie: Domain) -> None:
    domain = growth.varied(movie, 150)
    assert len(domain.records) == 150
    values = {(slot, text) for record in movie.records for slot, text in record.items()}
    assert {(slot, text) for record in domain.records for slot, text in record.items()} <= values
    assert tensorize(domain).n_values.tolist() == tensorize(movie).n_values.tolist()
