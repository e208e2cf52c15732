"""``bbq language measure``, ``train`` and ``count``, and the measurements of understanding."""

from __future__ import annotations

if __name__ == "__main__":  # before anything that takes time to import
    from bbq_torchrl.utils import interruption

    interruption.listen()

import argparse
import json
import math
import random
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import compress
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase

from bbq_torchrl.domains import Domain
from bbq_torchrl.domains.folder import SHIPPED, named_domain
from bbq_torchrl.people.language.corpus import make_examples, play
from bbq_torchrl.people.language.generator import Generator
from bbq_torchrl.people.language.training_lines import Line, read_lines, without_unknown
from bbq_torchrl.people.language.understander import SENTENCES, Understander, keys_of, same_frame
from bbq_torchrl.utils import output
from bbq_torchrl.utils.files import write_text

_DOMAIN = f"{', '.join(SHIPPED)}, or a domain's folder"


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns 0, or 2 after a line that says what is wrong."""
    parser = output.Parser(prog="bbq language")
    commands = parser.add_subparsers(dest="command", required=True)
    for name, help_ in (
        ("train", "train an understander and write its file"),
        ("measure", "train an understander and measure it on labeled sentences"),
    ):
        command = commands.add_parser(name, help=help_)
        command.add_argument("--domain", default="movie", help=_DOMAIN)
        command.add_argument(
            "--sentences", type=int, default=SENTENCES, help="of people to learn from"
        )
        command.add_argument("--seed", type=int, default=0)
        command.add_argument("--labeled", type=Path, help="your labeled lines, learned as well")
        command.add_argument("--file", type=Path, help="where the understander goes")
        if name == "measure":
            command.add_argument("--data", type=Path, help="folder of labeled sentences")
            command.add_argument("--dialogues", type=int, default=10_000, help="for the round trip")
            command.add_argument("--out", type=Path, help="JSON file")
    count = commands.add_parser(
        "count", help="count what is misheard of simulated users, for env.errors=measured"
    )
    count.add_argument("--domain", default="movie", help=_DOMAIN)
    count.add_argument("--turns", type=int, default=100_000, help="of users, at least")
    count.add_argument("--seed", type=int, default=0)
    count.add_argument(
        "--trained", nargs="+", default=[], help="run folders or shipped:<name>, to play half of it"
    )
    given = parser.parse_args(arguments)
    domain = named_domain(given.domain)
    if given.command == "count":
        return _count(given, domain)
    lines = [] if given.labeled is None else read_lines(given.labeled, domain)
    data = given.data if given.command == "measure" else None
    files = {} if data is None else labeled_files(data, domain)
    understand, figures = train_measured(domain, given.sentences, given.seed, lines)
    if given.file is not None or given.command == "train":
        understand.save(given.file or f"{domain.name}.language.npz")
    if given.command == "train":
        return 0
    figures["grammar"] = score_grammar(understand, given.seed)
    figures |= {name: score(understand, own) for name, own in files.items()}
    text = as_json(figures | measure_round_trip(understand, given.dialogues, given.seed))
    output.write(text)
    if not files:
        output.print_error(
            "people's sentences were not measured: the domain has no labeled ones; name a folder "
            "with --data"
        )
    out = given.out or Path(f"{domain.name}.language.json")
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, text)
    return 0


def _count(given: argparse.Namespace, domain: Domain) -> int:
    # Imported here: the language layer is below the environments, and needs no TorchRL.
    from bbq_torchrl.envs.text_channel import count_errors, save_errors

    torch.set_num_threads(1)
    trained = {name: _agent(name, domain) for name in given.trained}
    counts = count_errors(domain, given.turns, seed=given.seed, trained=trained)
    assert domain.folder is not None
    file = save_errors(domain.folder, counts)
    output.write(f"{counts['turns']} turns counted: {file}\n")
    return 0


def _agent(name: str, domain: Domain) -> TensorDictModuleBase:
    """Returns the policy of a run folder or a shipped agent in a domain."""
    from bbq_torchrl import load_run

    run = load_run(name, dialogues=1)
    own = getattr(run.env, "domain", None)
    if own is None or own.action_names != domain.action_names or run.config.replicas != 1:
        raise ValueError(
            f"--trained must name runs of one replica in the domain {domain.name}, got {name}"
        )
    return run.policy


SUREST = 0.8
"""The share of sentences to answer."""

_CHANCES = 200
_MADE = 2_000
_ROUND_TRIPS = 3_000  # turns


def score(
    understand: Understander, lines: Sequence[Line], change: Callable[[str], str] = str
) -> dict[str, float]:
    """Returns how well labeled lines are understood, by the names in ``results/``.

    ``frame`` and ``act`` are the shares that are exactly right. ``slot_f1`` is the F1 of pairs of
    slot and value, where "does not matter" counts as a value. ``answered`` is the share that the
    system does not ask about again. ``right_of_answered`` and ``right_of_surest`` are the shares of
    right frames among these and among the surest sentences.

    Args:
        understand: the understander.
        lines: the sentences with their meanings.
        change: a change made to each sentence first.
    """
    right, acts, confidences, answered = [], [], [], []
    shared = pairs = 0
    for question, text, label in lines:
        frame = without_unknown(label)
        heard = understand(change(text), question)
        got = keys_of(heard.frame, understand.lexicon).items()
        meant = keys_of(frame, understand.lexicon).items()
        right.append(same_frame(heard.frame, frame, understand.lexicon))
        acts.append(heard.frame.act == frame.act)
        confidences.append(heard.confidence)
        answered.append(not understand.asks(heard))
        shared += len(got & meant)
        pairs += len(got) + len(meant)
    surest = sorted(zip(confidences, right, strict=True), reverse=True)
    surest = surest[: math.ceil(SUREST * len(surest))]
    return {
        "sentences": len(right),
        "frame": fmean(right),
        "slot_f1": 2 * shared / max(pairs, 1),
        "act": fmean(acts),
        "answered": fmean(answered),
        "right_of_answered": fmean(compress(right, answered)) if any(answered) else 1.0,
        "right_of_surest": fmean(is_right for _, is_right in surest),
        "calibration_error": calibration_error(confidences, right),
        "calibration_floor": calibration_floor(confidences),
    }


def calibration_error(confidences: Sequence[float], right: Sequence[bool]) -> float:
    """Returns the expected calibration error in ten bins of confidence."""
    bins: dict[int, float] = {}
    for confidence, is_right in zip(confidences, right, strict=True):
        number = min(int(confidence * 10), 9)
        bins[number] = bins.get(number, 0.0) + confidence - is_right
    return sum(map(abs, bins.values())) / len(right)


def calibration_floor(confidences: Sequence[float]) -> float:
    """Returns the mean calibration error by chance alone, if every confidence is correct."""
    rng = random.Random(0)
    return fmean(
        calibration_error(confidences, [rng.random() < c for c in confidences])
        for _ in range(_CHANCES)
    )


def labeled_files(data: Path, domain: Domain) -> dict[str, list[Line]]:
    """Returns the labeled lines of the text files in a folder, by file name.

    Raises:
        ValueError: if the folder has no text files, or one is written in another way.
    """
    files = {file.stem: read_lines(file, domain) for file in sorted(data.glob("*.txt"))}
    if not any(files.values()):
        raise ValueError(
            f"--data must be a folder with labeled sentences in files *.txt, got {data}"
        )
    return {name: lines for name, lines in files.items() if lines}


def train_measured(
    domain: Domain, sentences: int = SENTENCES, seed: int = 0, labeled: Sequence[Line] = ()
) -> tuple[Understander, dict[str, Any]]:
    """Returns a trained understander, and what its training took; arguments as in training."""
    started = time.process_time()
    understand = Understander.train(domain, sentences=sentences, seed=seed, labeled=labeled)
    seconds = time.process_time() - started
    with TemporaryDirectory() as folder:
        understand.save(file := Path(folder, "understander.npz"))
        size = file.stat().st_size
    return understand, {
        "domain": domain.name,
        "learned_from": sentences,
        "seed": seed,
        "training_seconds": round(seconds, 1),
        "megabytes": round(size / 1e6, 2),
    }


def score_grammar(understand: Understander, seed: int) -> dict[str, float]:
    """Returns the scores of unseen sentences of the domain's grammar; ``seed`` is training's."""
    made = make_examples(understand.lexicon, _MADE, seed + 2)
    return score(understand, [Line(one.question, " ".join(one.words), one.frame) for one in made])


def measure_round_trip(
    understand: Understander, dialogues: int = 10_000, seed: int = 0
) -> dict[str, float]:
    """Returns the shares of simulated users' frames recovered from the grammar's sentences."""
    turns = play(understand.domain, dialogues, seed=seed)[:_ROUND_TRIPS]
    speak = Generator(understand.domain)
    lines = [
        Line(question, speak.user(frame, question, session=number), frame)
        for number, (question, frame) in enumerate(turns)
    ]
    result = score(understand, lines)
    return {
        "turns": len(lines),
        **{f"round_trip_{name}": result[name] for name in ("frame", "slot_f1", "act")},
    }


def as_json(figures: Mapping[str, Any]) -> str:
    """Returns figures as JSON, rounded to four decimals."""
    exact = json.dumps(figures)
    rounded = json.loads(exact, parse_float=lambda text: round(float(text), 4))
    return json.dumps(rounded, indent=1) + "\n"


if __name__ == "__main__":
    sys.exit(main())
