"""The pages as HTML, from templates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["best", "render"]

MAX_BARS = 12

_TEMPLATES = Environment(
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
    return _TEMPLATES.get_template(f"{template}.html").render(values)


def best(beliefs: Mapping[str, Any] | None) -> Sequence[Mapping[str, Any]]:
    """Returns the actions of an agent's beliefs that are drawn, the best first by mean.

    Args:
        beliefs: as plain data; ``None`` where it has none.
    """
    actions = beliefs["actions"] if beliefs else []
    return sorted(actions, key=lambda item: -item["mean"])[:MAX_BARS]
