"""The parts of the comparison: each returns its rows."""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.training import build_trainer
from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv
from bbq_torchrl.evaluation.play import evaluate
from benchmarks.parts import processes
from benchmarks.parts.accounts import RoundAccounts
from benchmarks.parts.dialogues import PUBLIC_RANDOM, PUBLIC_RULE, play_simulator
from benchmarks.parts.learning import AGENTS, Learner, full_trainer
from benchmarks.parts.rows import Row
from benchmarks.parts.time_to_learn import time_to_learn
from benchmarks.parts.timing import interleaved
from benchmarks.parts.yardstick import bare_block

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.parts.sizes import Sizes
    from benchmarks.parts.timing import Timer

    Part = Callable[[Sizes, Timer], list[Row]]

TURNS = (15_000, 80_000, 100_000)
UPDATE = {"dqn": 1.3, "bbqn-map": 2.3, "bbqn-mc": 2.9}
UPDATE_OF_MANY = {"dqn": 0.9, "bbqn-map": 2.0, "bbqn-mc": 2.6}
VIME_PERCENT, BOOTSTRAP, OVERHEAD_PERCENT, MEMORY_GB, HELP_SECONDS = 40, 4, 5, 1.5, 6
PAPER = ("dqn", "bbqn-map", "bbqn-mc")


def simulator(sizes: Sizes, timer: Timer) -> list[Row]:
    """Turns a second, features included, and how many times the public simulator's."""
    rows = [
        Row(
            "simulator",
            f"simulator, {dialogues:,} dialogues in parallel",
            "turns/s",
            _turns_per_second(dialogues, "random", sizes, timer),
            target,
            "higher",
        )
        for dialogues, target in zip(sizes.dialogues, TURNS, strict=True)
    ]
    for policy, public, target in (("random", PUBLIC_RANDOM, 100), ("rule", PUBLIC_RULE, 40)):
        ours = _turns_per_second(sizes.public_dialogues, policy, sizes, timer)
        what = f"simulator, {policy} policy under errors, {sizes.public_dialogues:,} dialogues"
        unit = f"times the public one's {public:,} turns/s"
        rows.append(Row("simulator", what, unit, ours / public, target, "higher"))
    return rows


def _turns_per_second(dialogues: int, policy: str, sizes: Sizes, timer: Timer) -> float:
    play = play_simulator(DialogueEnv(movie_domain(), batch_size=(dialogues,), seed=0), policy)
    valid = play()
    return valid / median(timer.time(play) for _ in range(sizes.plays))


def update(sizes: Sizes, timer: Timer) -> list[Row]:
    """An update of one network, sampling included, beside the yardstick."""
    return _updates("update", PAPER, UPDATE, 1, sizes.capacity, sizes, timer)


def replicas(sizes: Sizes, timer: Timer) -> list[Row]:
    """The same for a network among many, per replica."""
    targets = UPDATE_OF_MANY
    return _updates("replicas", PAPER, targets, sizes.many, sizes.many_capacity, sizes, timer)


def agents(sizes: Sizes, timer: Timer) -> list[Row]:
    """The same for the other agents."""
    others = tuple(name for name in AGENTS if name not in PAPER)
    return _updates("agents", others, {}, 1, sizes.capacity, sizes, timer)


def _updates(
    part: str,
    names: tuple[str, ...],
    targets: dict[str, float],
    number: int,
    capacity: int,
    sizes: Sizes,
    timer: Timer,
) -> list[Row]:
    rows = []
    bare = bare_block(timer, sizes.bare_updates)
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            learner = Learner(
                (*AGENTS[name], *sizes.overrides),
                Path(folder) / "run",
                timer,
                replicas=number,
                capacity=capacity,
            )
            learner.learn()
            learning = interleaved(bare, learner.learn, sizes.repeats)
            ready = interleaved(
                bare,
                lambda learner=learner: learner.update_ready_batch(sizes.bare_updates // number),
                sizes.repeats,
            )
        what = f"update of {name}, replicas={number}, buffer of {capacity:,}"
        unit = "times a bare DQN update"
        rows += [
            Row(part, f"{what}, sampling included", unit, learning.ratio, targets.get(name)),
            Row(part, f"{what}, of a ready batch", unit, ready.ratio),
            Row(part, f"{what}, sampling included", "ms", 1e3 * learning.seconds),
            Row(
                part, f"bare DQN update beside {name}, replicas={number}", "ms", 1e3 * learning.base
            ),
        ]
    return rows


def vime(sizes: Sizes, timer: Timer) -> list[Row]:
    """What VIME adds to a round's storing and learning: bonus, its reading, the dynamics."""
    rows = []
    for base, name in (("dqn", "dqn-vime-map"), ("bbqn-map", "bbqn-vime-map")):
        ratio = _beside(base, name, "store_and_learn", sizes, timer)
        what = f"bonus and training of {name} on top of {base}"
        rows.append(Row("vime", what, "%", 100 * (ratio - 1), VIME_PERCENT))
    return rows


def bootstrap(sizes: Sizes, timer: Timer) -> list[Row]:
    """Bootstrapped DQN with ten heads beside DQN."""
    ratio = _beside("dqn", "bootstrap, 10 heads", "learn", sizes, timer)
    return [Row("bootstrap", "update of bootstrap, 10 heads", "times DQN's", ratio, BOOTSTRAP)]


def _beside(base: str, name: str, method: str, sizes: Sizes, timer: Timer) -> float:
    """Returns the ratio of two agents' learning, in turn."""
    freezes = 2 if method == "store_and_learn" else 1
    with tempfile.TemporaryDirectory() as folder:
        blocks = []
        for agent in (base, name):
            learner = Learner(
                (*AGENTS[agent], *sizes.overrides),
                Path(folder) / agent,
                timer,
                capacity=sizes.capacity,
                freezes=freezes,
            )
            learner.learn()
            blocks.append(getattr(learner, method))
        return interleaved(blocks[0], blocks[1], sizes.repeats).ratio


def run(sizes: Sizes, timer: Timer) -> list[Row]:
    """What a round of ``agent=bbqn env=full`` spends outside of simulator and updates."""
    overrides = ("agent=bbqn", "env=full", *sizes.overrides)
    with tempfile.TemporaryDirectory() as folder:
        started = timer.now()
        trainer = full_trainer(overrides, Path(folder) / "run", replicas=1, capacity=sizes.capacity)
        accounts = RoundAccounts(trainer, timer.now)
        first = accounts.round()
        start = timer.now() - started
        rounds = [accounts.round() for _ in range(sizes.rounds)]
        accounts.restore()
        save = timer.time(lambda: trainer.checkpoints.save(0, {}, name="timed"))
    checkpoint = save / trainer.settings.checkpoint_every
    kinds = {name: median(row[name] for row in rounds) for name in first}
    whole = kinds["round"] + checkpoint
    overhead = kinds["bookkeeping"] + checkpoint
    # The start is what a process does before its first round, and the first round's compilation.
    start += processes.python("-c", "import bbq_torchrl.run").wall - whole
    number = sizes.run_rounds
    of_run = (start + number * overhead) / (start + number * whole)
    what = "agent=bbqn env=full, a round with a full buffer"
    shares = [
        Row("run", f"{what}: {name}", "% of the round", 100 * seconds / whole)
        for name, seconds in (
            ("playing", kinds["playing"]),
            ("updates", kinds["updates"]),
            ("storing", kinds["storing"]),
            ("shuffling and batching", kinds["batches"]),
            ("a tenth of a checkpoint", checkpoint),
        )
    ]
    return [
        Row(
            "run",
            f"{what}: outside simulator and updates",
            "%",
            100 * overhead / whole,
            OVERHEAD_PERCENT,
        ),
        Row(
            "run",
            f"{number} such rounds and the start of the process",
            "%",
            100 * of_run,
            OVERHEAD_PERCENT,
        ),
        *shares,
        Row("run", what, "s", whole),
    ]


def evaluation(sizes: Sizes, timer: Timer) -> list[Row]:
    """The final evaluation: dialogues a second of the network at the mean weights."""
    config = compose(["agent=bbqn", *sizes.overrides])
    places = min(config.protocol.eval_batch, sizes.eval_dialogues)
    with tempfile.TemporaryDirectory() as folder:
        trainer, agent = build_trainer(config, Path(folder) / "run")
    env = DialogueEnv(trainer.env.domain, batch_size=(1, places), seed=0)
    _, policy = config.agent.make_evaluation(agent.actor)
    seconds = timer.time(lambda: evaluate(env, policy, sizes.eval_dialogues))
    what = f"evaluation of bbqn, {sizes.eval_dialogues:,} dialogues, {places:,} in parallel"
    return [Row("evaluation", what, "dialogues/s", sizes.eval_dialogues / seconds)]


def memory(sizes: Sizes, timer: Timer) -> list[Row]:
    """The most memory of a whole run: full buffers, a few rounds, the final evaluation."""
    number = sizes.memory_replicas
    with tempfile.TemporaryDirectory() as folder:
        used = processes.python(
            "train.py",
            "agent=bbqn",
            "env=full",
            f"replicas={number}",
            f"spike.dialogues={sizes.spike}",
            "spike.protect=false",
            f"protocol.rounds={sizes.memory_rounds}",
            f"protocol.eval_dialogues={sizes.eval_dialogues}",
            f"hydra.run.dir={folder}/run",
            *sizes.overrides,
        )
    what = f"agent=bbqn env=full replicas={number}: peak of resident memory"
    return [Row("memory", what, "GB", used.peak_bytes / 1e9, MEMORY_GB)]


def start(sizes: Sizes, timer: Timer) -> list[Row]:
    """How long the first line of output takes, and imports."""
    repeats = min(sizes.repeats, 3)
    used = [processes.python(*processes.HELP).wall for _ in range(repeats)]
    rows = [Row("start", "python train.py --help", "s", median(used), HELP_SECONDS)]
    for name in processes.IMPORTS if sizes.imports else ():
        used = [processes.python("-c", f"import {name}").wall for _ in range(repeats)]
        rows.append(Row("start", f"import {name}", "s", median(used)))
    return rows


PARTS: dict[str, Part] = {
    part.__name__: part
    for part in (
        simulator,
        update,
        replicas,
        vime,
        bootstrap,
        agents,
        run,
        evaluation,
        memory,
        start,
        time_to_learn,
    )
}
"""Name -> what measures it, in the order of the table."""
