"""The least times, from results/floor.json, beside the times measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts.docs_blocks.markdown import table
from scripts.docs_blocks.speed import number

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

__all__ = ["floor_blocks"]

RESULTS = Path(__file__).resolve().parents[2] / "results"
UNMEASURED = "Not measured yet; `python benchmarks/floor.py` does."
COUNTED = ("operations", "bytes", "normals", "uniforms", "functions")
BARE, TURNS = "bare dqn", 1_000


def floor_blocks() -> dict[str, Callable[[], str]]:
    """Returns the blocks of the machine's rates, of the work, and of the ratios."""
    return {"floor.rates": _rates, "floor.work": _work, "floor.ratios": _ratios}


def _read(name: str) -> Any:
    file = RESULTS / name
    return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None


def _rates() -> str:
    measured = _read("floor.json")
    if measured is None:
        return UNMEASURED
    rows = [
        (kind.removesuffix(" per second"), what, f"{rate / 1e9:.3g}")
        for kind, rates in measured["rates"].items()
        for what, rate in rates.items()
    ]
    return table(("", "of", "thousand million a second"), rows, numbers=1)


def _steps(measured: dict[str, Any]) -> Iterable[tuple[str, list[dict[str, Any]]]]:
    for agent, steps in measured["updates"].items():
        yield f"update of {agent}", steps
    yield "turn of a dialogue", measured["turn"]


def _work() -> str:
    """Returns a row for every step."""
    measured = _read("floor.json")
    if measured is None:
        return UNMEASURED
    rows = []
    for what, steps in _steps(measured):
        sums = {name: sum(step[name] for step in steps) for name in (*COUNTED, "least_seconds")}
        for step in [*steps, {"step": "**all**", **sums}]:
            random_numbers = step["normals"] + step["uniforms"]
            rows.append(
                (
                    what,
                    step["step"],
                    *(_count(step[name]) for name in ("operations", "bytes")),
                    *(_count(count) for count in (random_numbers, step["functions"])),
                    f"{1e6 * step['least_seconds']:.3g}",
                )
            )
            what = ""
    head = ("", "step", "operations", "bytes", "random numbers", "exp, log", "least µs")
    return table(head, rows, numbers=5)


def _count(value: float) -> str:
    return "–" if value == 0 else f"{value:,.0f}"


def _ratios() -> str:
    """Returns the least time beside the one measured in the comparison."""
    measured, compared = _read("floor.json"), _read("compare.json")
    if measured is None:
        return UNMEASURED
    entries = [] if compared is None else compared["rows"]
    least = {what: sum(step["least_seconds"] for step in steps) for what, steps in _steps(measured)}
    rows = []
    for agent in measured["updates"]:
        seconds = _milliseconds(entries, f"update of {agent}, replicas=1,")
        if agent == BARE:
            seconds = measured["bare_update_seconds"]
        rows.append(_row(f"update of {agent}", least[f"update of {agent}"], seconds))
    turn = least["turn of a dialogue"] / measured["valid_share"]
    speed = next(
        (
            entry["measured"]
            for entry in entries
            if entry["what"] == f"simulator, {TURNS:,} dialogues in parallel"
        ),
        None,
    )
    rows.append(_row("valid turn of a dialogue", turn, None if speed is None else 1 / speed))
    head = ("what", "least µs", "measured µs", "times the least")
    return table(head, rows, numbers=3)


def _row(what: str, least: float, measured: float | None) -> tuple[str, ...]:
    if measured is None:
        return what, _micro(least), "–", "–"
    return what, _micro(least), _micro(measured), f"{measured / least:.2g}"


def _micro(seconds: float) -> str:
    return number(1e6 * seconds)


def _milliseconds(entries: list[dict[str, Any]], beginning: str) -> float | None:
    for entry in entries:
        if entry["what"].startswith(beginning) and entry["unit"] == "ms":
            return entry["measured"] / 1e3
    return None
