"""Lower bounds of the times of an update and a turn: their work at the machine's measured rates.

The work is counted for a 268-256-256-39 network and a batch of 32. Each step reads and writes its
float32 vectors once, as if it were a single pass. Savings from merging steps, such as a gradient
that is never written, are not considered.
"""

from __future__ import annotations

import itertools
from collections import Counter
from statistics import median
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.bayes.noise import fill_normal_
from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.trainers import rollout
from benchmarks.parts.rows import Row
from benchmarks.parts.timing import seconds
from benchmarks.parts.yardstick import ACTIONS, BATCH, FEATURES, HIDDEN, bare_block

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.parts.sizes import Sizes

FLOAT, LOCKSTEP = 4, 1_000
BLOCKS, BLOCK_SECONDS = 15, 0.02
EPOCHS, UPDATES_PER_EPOCH = 2, 313
"""Epochs for which a target is computed once; updates per epoch of 10,000 transitions."""
POOL = 8
"""Weight draws in the pool of normal numbers; an epoch's draws are windows of it."""


Work = Counter[str]
"""How many a step does; or the machine in a second: of ``operations`` (multiplications and
additions of matrix products), ``bytes`` read and written, ``normals`` (normally distributed random
numbers), ``uniforms`` and ``functions`` (exponentials and logarithms)."""


def least_seconds(work: Work, rates: Work) -> float:
    """Returns the time of the work at these rates, without overlap."""
    return sum(count / rates[kind] for kind, count in work.items())


LAYERS = tuple(itertools.pairwise((FEATURES, *HIDDEN, ACTIONS)))
WEIGHTS = sum(inputs * outputs for inputs, outputs in LAYERS)
PARAMETERS = WEIGHTS + sum(outputs for _, outputs in LAYERS)
VECTOR = FLOAT * PARAMETERS
"""Bytes of a vector of all parameters."""

_BEHIND_FIRST = sum(inputs * outputs for inputs, outputs in LAYERS[1:])
_PASS = 2.0 * BATCH * WEIGHTS
_GATHER = Work(bytes=2.0 * BATCH * (2 * (FEATURES * FLOAT + ACTIONS) + 8 + FLOAT + 2))
_FORWARD = Work(operations=_PASS, bytes=VECTOR)
_FIXED_TARGET = Work(operations=_PASS / EPOCHS)
_BACKWARD = Work(
    operations=_PASS + 2.0 * BATCH * _BEHIND_FIRST, bytes=FLOAT * _BEHIND_FIRST + VECTOR
)
# reads μ, ρ and noise; writes the weights, and σ for the gradient: softplus is an exponential and
# a logarithm. Pool and value of the KL are an epoch's
_DRAW = Work(
    bytes=5 * VECTOR,
    normals=POOL * PARAMETERS / UPDATES_PER_EPOCH,
    functions=(2.0 + 1.0 / UPDATES_PER_EPOCH) * PARAMETERS,
)
# reads the weights' gradient, noise, σ and μ; writes the gradients of μ and ρ
_DRAW_BACKWARD = Work(bytes=6 * VECTOR, functions=PARAMETERS)
# reads the frozen μ, its σ, which is an epoch's, and noise; writes weights
_TARGET_DRAW = Work(bytes=4 * VECTOR)
# reads parameters, gradients and both moments; writes all but the gradients
_ADAM = Work(bytes=7 * VECTOR)
_BBQN = _GATHER + _DRAW + _FORWARD + _BACKWARD + _DRAW_BACKWARD + _ADAM + _ADAM

UPDATES = {
    "bare dqn": _FORWARD + _FORWARD + _BACKWARD + _ADAM,
    "dqn": _GATHER + _FORWARD + _FIXED_TARGET + _BACKWARD + _ADAM,
    "bbqn-map": _BBQN + _FIXED_TARGET,
    "bbqn-mc": _BBQN + _TARGET_DRAW + _FORWARD,
}
"""Agent -> the work of an update. The bare one has a ready batch and two forward passes."""


def turn(env: DialogueEnv) -> Work:
    """Returns the work of a dialogue's turn, counted on the simulator's tensors."""
    simulator = env.simulator
    state = simulator.reset(simulator.draw_reset((1,)), env.active_slots)
    numbers = sum(entry.numel() for entry in simulator.draw_turn((1,)).values())
    knowledge_base = simulator.knowledge_base
    words = knowledge_base.sets.shape[-1] + knowledge_base.ordered_sets.shape[-1]
    return Work(
        bytes=2.0 * FLOAT * numbers  # the random numbers
        + 2.0 * sum(entry.nbytes for entry in state.values())
        + 8.0 * words * knowledge_base.slots.numel()  # to match records and fill a slot
        + FLOAT * simulator.layout.size,
        uniforms=numbers,
    )


def valid_share(env: DialogueEnv) -> float:
    """Returns the share of a random policy's lockstep turns before the dialogues' ends."""
    env.set_seed(0)
    torch.manual_seed(0)
    return rollout(env, scripted_policy("random", env))["valid"].float().mean().item()


def rates() -> Work:
    """Measures the machine on one thread: the best of short blocks.

    A large matrix product; a copy within the third-level cache, where the vectors of one network
    fit; the library's normal numbers, torch's uniform ones and exponentials.
    """

    def rate(count: float, work: Callable[[], object]) -> float:
        work()
        repeats = max(1, int(BLOCK_SECONDS / max(seconds(work), 1e-7)))
        blocks = (seconds(lambda: [work() for _ in range(repeats)]) for _ in range(BLOCKS))
        return count * repeats / min(blocks)

    left, right, out = (torch.randn(1024, 1024) for _ in range(3))
    source, target = (torch.zeros(1024**2) for _ in range(2))
    vector, other = torch.rand(PARAMETERS), torch.empty(PARAMETERS)
    return Work(
        operations=rate(2.0 * 1024**3, lambda: torch.mm(left, right, out=out)),
        bytes=rate(2.0 * source.nbytes, lambda: target.copy_(source)),
        normals=rate(PARAMETERS, lambda: fill_normal_(vector)),
        uniforms=rate(PARAMETERS, vector.uniform_),
        functions=rate(PARAMETERS, lambda: torch.exp(vector, out=other)),
    )


def floor(sizes: Sizes) -> list[Row]:
    """Measures lower bounds, and the bare update in the same process."""
    measured, bare = rates(), bare_block(sizes.bare_updates)
    env = DialogueEnv(movie_domain(), batch_size=(LOCKSTEP,), seed=0)
    valid_turn = least_seconds(turn(env), measured) / valid_share(env)
    updates = {agent: least_seconds(work, measured) for agent, work in UPDATES.items()}
    return [
        *(
            Row("floor", f"least time of an update of {agent}", "ms", 1e3 * took)
            for agent, took in updates.items()
        ),
        Row("floor", "bare DQN update", "ms", 1e3 * median(bare() for _ in range(sizes.repeats))),
        Row("floor", "least time of a valid turn", "µs", 1e6 * valid_turn),
    ]
