"""Updates of every agent as users run it, relative to the baseline, and of agents to each other."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.parts.learning import AGENTS, learning_block
from benchmarks.parts.rows import Row
from benchmarks.parts.timing import interleaved
from benchmarks.parts.yardstick import bare_block

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.parts.sizes import Sizes

TARGETS = {"dqn": (1.35, 0.9), "bbqn-map": (2.1, 1.75), "bbqn-mc": (2.6, 2.1)}
"""Agent -> limit of its update in bare updates, with one network and with many."""

VIME_PERCENT, BOOTSTRAP = 40, 4
"""Limits: VIME's addition to storing and learning; an update of ten heads in DQN updates."""


def update(sizes: Sizes) -> list[Row]:
    """The paper's agents, including sampling, with one network and with many: a row for each."""
    return [
        row
        for place, (replicas, capacity) in enumerate(((1, sizes.capacity), sizes.many))
        for name in TARGETS
        for row in _update("update", name, TARGETS[name][place], replicas, capacity, sizes)
    ]


def agents(sizes: Sizes) -> list[Row]:
    """The other agents, one network; what VIME adds, and ten heads."""
    rows = []
    for base, name in (("dqn", "dqn-vime-map"), ("bbqn-map", "bbqn-vime-map")):
        percent = 100 * (_beside(base, name, sizes, freezes=2, stores=True) - 1)
        what = f"bonus and training of {name} on top of {base}"
        rows.append(Row("agents", what, "%", percent, VIME_PERCENT))
    times = _beside("dqn", "bootstrap, 10 heads", sizes)
    rows.append(Row("agents", "update of bootstrap, 10 heads", "times DQN's", times, BOOTSTRAP))
    for name in (name for name in AGENTS if name not in TARGETS):
        rows += _update("agents", name, None, 1, sizes.capacity, sizes)
    return rows


def _update(
    part: str,
    name: str,
    target: float | None,
    replicas: int,
    capacity: int,
    sizes: Sizes,
) -> Sequence[Row]:
    with tempfile.TemporaryDirectory() as folder:
        overrides, run = (*AGENTS[name], *sizes.overrides), Path(folder) / "run"
        block = learning_block(overrides, run, replicas=replicas, capacity=capacity)
        measured = interleaved(bare_block(sizes.bare_updates), block, sizes.repeats)
    what = f"update of {name}, replicas={replicas}, buffer of {capacity:,}, sampling included"
    return (
        Row(part, what, "times a bare DQN update", measured.ratio, target),
        Row(part, what, "ms", 1e3 * measured.seconds),
    )


def _beside(base: str, name: str, sizes: Sizes, **options: Any) -> float:
    """Returns the ratio of two agents' learning times, measured alternately."""
    with tempfile.TemporaryDirectory() as folder:
        blocks = [
            learning_block(
                (*AGENTS[agent], *sizes.overrides),
                Path(folder) / agent,
                capacity=sizes.capacity,
                **options,
            )
            for agent in (base, name)
        ]
        return interleaved(*blocks, sizes.repeats).ratio
