"""The history of versions keeps predictions and takes in measurements."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

from scripts.measure_speed import keep_version

if TYPE_CHECKING:
    from pathlib import Path


def test_measurement_goes_beside_its_prediction_and_versions_before_stay(tmp_path: Path) -> None:
    file = tmp_path / "history.csv"
    file.write_text(
        "version,what,unit,predicted,measured\nold,update,times,,3.5\nnew,update,times,2,\n",
        encoding="utf-8",
    )
    rows = [
        {"what": "update", "unit": "times", "measured": 2.12345, "target": 2.3},
        {"what": "turns", "unit": "turns/s", "measured": 90_000.0, "target": 80_000},
        {"what": "a detail", "unit": "ms", "measured": 1.0, "target": None},
    ]
    keep_version("new", rows, file)
    with file.open(newline="", encoding="utf-8") as opened:
        lines = [tuple(line.values()) for line in csv.DictReader(opened)]
    assert lines == [
        ("old", "update", "times", "", "3.5"),
        ("new", "update", "times", "2", "2.123"),
        ("new", "turns", "turns/s", "", "90000"),
    ]
