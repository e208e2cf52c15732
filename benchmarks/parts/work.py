"""What an update and a turn have to do at least: operations, bytes, random numbers.

Counted for vectors of float32 that are read and written once in each step, as if every step were
one pass. What could be left out by merging steps (a gradient that is never written, say) is not.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from benchmarks.parts.yardstick import ACTIONS, BATCH, FEATURES, HIDDEN

if TYPE_CHECKING:
    from bbq_torchrl.envs import DialogueEnv

FLOAT = 4
EPOCHS = 2
"""Epochs over the buffer after a freeze: how often a target is used that is computed once."""
UPDATES_PER_EPOCH = 313
"""Of a buffer of 10,000 transitions."""
POOL = 8
"""Weight draws whose normal numbers an epoch's draws are windows of."""


@dataclass(frozen=True)
class Work:
    """What a step does.

    Attributes:
        step: its name.
        operations: multiplications and additions of matrix products.
        bytes: read and written.
        normals: normally distributed random numbers drawn.
        uniforms: uniformly distributed ones.
        functions: exponentials and logarithms.
    """

    step: str
    operations: float = 0.0
    bytes: float = 0.0
    normals: float = 0.0
    uniforms: float = 0.0
    functions: float = 0.0


LAYERS = tuple(itertools.pairwise((FEATURES, *HIDDEN, ACTIONS)))
WEIGHTS = sum(inputs * outputs for inputs, outputs in LAYERS)
PARAMETERS = WEIGHTS + sum(outputs for _, outputs in LAYERS)
_BEHIND_FIRST = sum(inputs * outputs for inputs, outputs in LAYERS[1:])
_FORWARD = 2.0 * BATCH * WEIGHTS
_ROW_BYTES = 2 * (FEATURES * FLOAT + ACTIONS) + 8 + FLOAT + 2


def _vectors(count: float) -> float:
    """Returns the bytes of so many vectors as long as the network has parameters."""
    return FLOAT * count * PARAMETERS


_GATHER = Work("gather the batch", bytes=2.0 * BATCH * _ROW_BYTES)
_ONLINE = Work("forward", operations=_FORWARD, bytes=_vectors(1))
_FIXED_TARGET = Work("target, once a freeze", operations=_FORWARD / EPOCHS)
_BACKWARD = Work(
    "backward",
    operations=_FORWARD + 2.0 * BATCH * _BEHIND_FIRST,
    bytes=FLOAT * _BEHIND_FIRST + _vectors(1),
)
# reads μ, ρ and noise; writes the weights, and σ for the gradient: softplus is an exponential and
# a logarithm. Pool and value of the KL are an epoch's
_DRAW = Work(
    "draw",
    bytes=_vectors(5),
    normals=POOL * PARAMETERS / UPDATES_PER_EPOCH,
    functions=(2.0 + 1.0 / UPDATES_PER_EPOCH) * PARAMETERS,
)
# reads the weights' gradient, noise, σ and μ; writes the gradients of μ and ρ
_DRAW_BACKWARD = Work("backward of draw and KL", bytes=_vectors(6), functions=1.0 * PARAMETERS)
# reads the frozen μ, its σ, which is an epoch's, and noise; writes weights
_TARGET_DRAW = Work("draw of the target", bytes=_vectors(4))
_TARGET = Work("target", operations=_FORWARD, bytes=_vectors(1))


def _adam(vectors: int) -> Work:
    # reads parameters, gradients and both moments; writes all but the gradients
    return Work("Adam", bytes=_vectors(7 * vectors))


UPDATES: dict[str, tuple[Work, ...]] = {
    "bare dqn": (_ONLINE, _TARGET, _BACKWARD, _adam(1)),
    "dqn": (_GATHER, _ONLINE, _FIXED_TARGET, _BACKWARD, _adam(1)),
    "bbqn-map": (
        _GATHER,
        _DRAW,
        _ONLINE,
        _FIXED_TARGET,
        _BACKWARD,
        _DRAW_BACKWARD,
        _adam(2),
    ),
    "bbqn-mc": (
        _GATHER,
        _DRAW,
        _ONLINE,
        _TARGET_DRAW,
        _TARGET,
        _BACKWARD,
        _DRAW_BACKWARD,
        _adam(2),
    ),
}
"""Agent -> the steps of an update of one network with a batch of 32.

The bare update has its batch ready, and runs the target's network every time.
"""


def turn(env: DialogueEnv) -> tuple[Work, ...]:
    """Returns what a turn of one dialogue does; counted on the simulator's own tensors."""
    simulator, active = env.simulator, env.active_slots
    state = simulator.reset(simulator.draw_reset((1,)), active)
    draws = simulator.draw_turn((1,))
    shelf = simulator.knowledge_base
    state_bytes = sum(entry.nbytes for entry in state.values())
    numbers = sum(entry.numel() for entry in draws.values())
    words = shelf.sets.shape[-1] + shelf.ordered_sets.shape[-1]
    return (
        Work("draw random numbers", bytes=2.0 * FLOAT * numbers, uniforms=numbers),
        Work("state", bytes=2.0 * state_bytes),
        Work("match records, fill a slot", bytes=8.0 * words * shelf.slots.numel()),
        Work("features", bytes=FLOAT * simulator.layout.size),
    )


def valid_share(env: DialogueEnv) -> float:
    """Returns the share of a random policy's turns in lockstep that are before a dialogue's end."""
    env.set_seed(0)
    torch.manual_seed(0)
    done = env.rollout(env.max_agent_turns, break_when_any_done=False, break_when_all_done=True)[
        "next", "done"
    ].squeeze(-1)
    return ((done.cumsum(-1) - done.long()) == 0).float().mean().item()
