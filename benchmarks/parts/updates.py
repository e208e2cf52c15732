"""An update of every agent as users run it, beside the yardstick; and of agents beside others."""

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
    from benchmarks.parts.timing import Timer

TARGETS = {"dqn": (1.35, 0.9), "bbqn-map": (2.1, 1.75), "bbqn-mc": (2.6, 2.1)}
"""Agent -> bare updates that its update may take: of one network, of each of many."""

VIME_PERCENT, BOOTSTRAP = 40, 4
"""Most that VIME may add to storing and learning; DQN updates that one with ten heads may take."""


def update(sizes: Sizes, timer: Timer) -> list[Row]:
    """The paper's agents, sampling included, one network and many: a row of each network's time."""
    return [
        row
        for place, (replicas, capacity) in enumerate(sizes.capacity.items())
        for name in TARGETS
        for row in _update("update", name, TARGETS[name][place], replicas, capacity, sizes, timer)
    ]


def agents(sizes: Sizes, timer: Timer) -> list[Row]:
    """The other agents, one network; what VIME adds, and ten heads."""
    rows = []
    for base, name in (("dqn", "dqn-vime-map"), ("bbqn-map", "bbqn-vime-map")):
        percent = 100 * (_beside(base, name, sizes, timer, freezes=2, stores=True) - 1)
        what = f"bonus and training of {name} on top of {base}"
        rows.append(Row("agents", what, "%", percent, VIME_PERCENT))
    times = _beside("dqn", "bootstrap, 10 heads", sizes, timer)
    rows.append(Row("agents", "update of bootstrap, 10 heads", "times DQN's", times, BOOTSTRAP))
    for name in (name for name in AGENTS if name not in TARGETS):
        rows += _update("agents", name, None, 1, sizes.capacity[1], sizes, timer)
    return rows


def _update(
    part: str,
    name: str,
    target: float | None,
    replicas: int,
    capacity: int,
    sizes: Sizes,
    timer: Timer,
) -> Sequence[Row]:
    with tempfile.TemporaryDirectory() as folder:
        overrides, run = (*AGENTS[name], *sizes.overrides), Path(folder) / "run"
        block = learning_block(overrides, run, timer, replicas=replicas, capacity=capacity)
        measured = interleaved(bare_block(timer, sizes.bare_updates), block, sizes.repeats)
    what = f"update of {name}, replicas={replicas}, buffer of {capacity:,}, sampling included"
    return (
        Row(part, what, "times a bare DQN update", measured.ratio, target),
        Row(part, what, "ms", 1e3 * measured.seconds),
    )


def _beside(base: str, name: str, sizes: Sizes, timer: Timer, **options: Any) -> float:
    """Returns the ratio of two agents' learning, in turn."""
    with tempfile.TemporaryDirectory() as folder:
        blocks = [
            learning_block(
                (*AGENTS[agent], *sizes.overrides),
                Path(folder) / agent,
                timer,
                capacity=sizes.capacity[1],
                **options,
            )
            for agent in (base, name)
        ]
        return interleaved(*blocks, sizes.repeats).ratio
