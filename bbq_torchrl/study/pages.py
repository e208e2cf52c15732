"""The pages as HTML, from templates; what is shown of a goal, of beliefs, of a text."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.values import DONT_CARE, RESERVED_TEXT, fold

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from jinja2 import Environment

    from bbq_torchrl.domains import Goal

__all__ = ["STATIC_FILES", "bars", "card", "render", "static"]

STATIC_FILES = {"study.css": "text/css", "study.js": "text/javascript"}
"""The files beside the templates, with their media types."""

MAX_BARS = 12

_DONT_CARE = fold(RESERVED_TEXT[DONT_CARE])


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("bbq_torchrl.study"),
        autoescape=True,
        auto_reload=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render(template: str, /, **values: Any) -> str:
    """Returns a page.

    Args:
        template: name of its file, without ``.html``.
        values: what it shows; everything is escaped.
    """
    return _environment().get_template(f"{template}.html").render(values)


@cache
def static(name: str) -> bytes:
    """Returns one of :data:`STATIC_FILES`."""
    return files("bbq_torchrl.study").joinpath("static", name).read_bytes()


def card(goal: Goal, labels: Mapping[str, str]) -> dict[str, Any]:
    """Returns what a goal card shows.

    Args:
        goal: the person's.
        labels: how people call the slots.

    Returns:
        ``wishes``, pairs of label and value, and ``questions``, labels.
    """
    return {
        "wishes": [
            (labels.get(slot, slot), "anything" if fold(value) == _DONT_CARE else value)
            for slot, value in goal.constraints.items()
        ],
        "questions": [labels.get(slot, slot) for slot in goal.requests],
    }


def bars(actions: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Returns what is drawn of an agent's beliefs: its best actions by mean, bands in percent.

    Args:
        actions: beliefs as plain data.
    """
    best = sorted(actions, key=lambda item: -item["mean"])[:MAX_BARS]
    low = min((item["band90"][0] for item in best), default=0.0)
    width = max((item["band90"][1] for item in best), default=1.0) - low or 1.0

    def place(value: float) -> float:
        return round(100 * (value - low) / width, 2)

    return [
        {
            **item,
            "at": place(item["mean"]),
            **{
                f"{key}_{name}": number
                for key in ("band50", "band90")
                for name, number in (
                    ("at", place(item[key][0])),
                    ("width", round(place(item[key][1]) - place(item[key][0]), 2)),
                )
            },
        }
        for item in best
    ]
