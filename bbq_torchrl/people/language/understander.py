"""From a user's text to a frame with values of the domain; trained once for a domain and cached."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import math
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bbq_torchrl.domains import Domain
from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.language.asking import FOREIGN, OPENING, Unclear, Understood
from bbq_torchrl.people.language.assembly import assemble
from bbq_torchrl.people.language.corpus import Example, make_examples, spoiled
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.model import IntentNet, Model, Tagger, fit
from bbq_torchrl.people.language.paraphrase import Paraphraser
from bbq_torchrl.people.language.phrases import LANGUAGE_FILE
from bbq_torchrl.people.language.sentence_features import Features
from bbq_torchrl.people.language.training_lines import (
    DRILLED_FILE,
    LEARNED_FILE,
    Line,
    as_examples,
    lines_of,
    make_foreign,
    read_lines,
    varied,
)
from bbq_torchrl.people.language.words import words_of
from bbq_torchrl.utils.files import write_bytes

SENTENCES = 9_400
"""The maximum number of people's sentences to learn from."""

THRESHOLD = 0.65
"""The confidence below which to ask again: .8 of the held-out sentences are above it."""

_STEPS = 40  # of the tagger's optimizer

_MAX_WORDS = 120
_CALM = 0.3  # of noise: the grammar's sentences are more crowded than people's
_OWN = 4  # at least one of the grammar's sentences to this many others
_PLAYED = 4  # simulated users' sentences to one of the others
_TAGGED = 16  # the tagger learns from one in this many of these
_COPIES = 4  # of each of people's sentences, with other values, at most
_UNKNOWN = 4  # one in this many of the grammar's sentences is also learned with other values
_FOREIGN = 2  # people's sentences to one out-of-domain sentence
_UNLEARNED = 20  # one in this many of people's sentences only fits the temperature
_FEWEST = 50  # of them; with fewer, the grammar's sentences fit it
_TEMPERATURES = np.geomspace(0.5, 20.0, 75)
_FORMAT = 2


class Understander:
    """Understands users of a domain.

    Args:
        lexicon: the domain's phrases and values.
        model: the learned parts.
        temperature: the confidence in a frame is the product of the probabilities of its parts to
            the power of one over this.

    Attributes:
        threshold: the confidence below which the caller should ask again.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> understand = Understander.train(movie_domain())  # doctest: +SKIP
        >>> str(understand("two tickets for wonka please").frame)  # doctest: +SKIP
        'request(ticket) inform(numberofpeople=2, moviename=wonka)'
    """

    threshold = THRESHOLD

    def __init__(self, lexicon: Lexicon, model: Model, temperature: float = 1.0) -> None:
        self.domain, self.lexicon = lexicon.domain, lexicon
        self._model = model
        self._temperature = temperature

    @classmethod
    def train(
        cls,
        domain: Domain,
        *,
        sentences: int = SENTENCES,
        seed: int = 0,
        labeled: Sequence[Line] = (),
    ) -> Understander:
        """Returns an understander trained on sentences of the domain's grammar.

        Equal arguments give bit-identical results. Torch runs on one thread during training. A
        terminal shows progress bars.

        Args:
            domain: the domain. Its folder may have a ``language.yaml`` and people's labeled lines,
                which are learned with the grammar's sentences: ``learned.txt``, as people type,
                and ``drilled.txt``, written for hard cases. One in twenty of the former only fits
                the temperature of the confidence.
            sentences: the maximum number of people's sentences to learn from. The grammar's
                sentences make up the rest, and are at least a quarter as many. Simulated users'
                sentences are four times as many, most of them for the net alone.
            seed: the seed of the sentences and of the net's initial weights.
            labeled: people's labeled lines, learned like ``learned.txt``.

        Raises:
            ValueError: if there are no sentences to learn from.
        """
        if sentences < 1:
            raise ValueError(f"sentences must be at least 1, got {sentences}")
        lexicon = Lexicon(domain)
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            lines, drilled = lines_of(domain, LEARNED_FILE), lines_of(domain, DRILLED_FILE)
            step = math.ceil((len(lines) + len(drilled)) / sentences) or 1
            people = as_examples([*lines[::step], *labeled], lexicon)
            unlearned = people[::_UNLEARNED]
            if len(unlearned) >= _FEWEST:
                del people[::_UNLEARNED]
            else:
                unlearned = make_examples(lexicon, max(sentences // 20, 200), seed + 1, noise=_CALM)
            people += as_examples(drilled[::step], lexicon)
            own = max(sentences - len(people), -(-sentences // _OWN))
            grammar = make_examples(lexicon, own, seed)
            played = make_examples(lexicon, _PLAYED * sentences, seed, simulated=True)
            paraphrase, some = Paraphraser(lexicon), grammar[::_UNKNOWN]
            copies = min(_COPIES, round(sentences / max(len(people), 1)))
            others = [*people, *varied(people, lexicon, paraphrase, copies, seed)]
            others += varied(some, lexicon, paraphrase, 1, seed)
            examples = [*grammar, *spoiled(others, seed), *played[::_TAGGED]]
            foreign = make_foreign(lexicon, grammar, sentences // _FOREIGN, seed)
            model = fit(lexicon, examples, played, foreign, seed=seed, steps=_STEPS)
            found = cls(lexicon, model)
            found._temperature = found._fitted_temperature(unlearned)
        finally:
            torch.set_num_threads(threads)
        return found

    def _fitted_temperature(self, examples: Sequence[Example]) -> float:
        """Returns the temperature at which the confidence fits unlearned sentences best."""
        chances, right = [], []
        for example in examples:
            frame, _, chance, _ = self._read(example.words, example.question)
            chances.append(chance)
            right.append(same_frame(frame, example.frame, self.lexicon))
        confidence = np.exp(np.array(chances) / _TEMPERATURES[:, None]).clip(1e-6, 1 - 1e-6)
        fits = np.log(np.where(right, confidence, 1 - confidence)).sum(-1)
        return float(_TEMPERATURES[fits.argmax()])

    def __call__(self, text: str, question: Frame | None = None) -> Understood:
        """Returns the meaning of ``text``.

        Args:
            text: the user's text.
            question: the agent's last act; ``None`` at the opening.

        Raises:
            TextError: a ``ValueError`` fit to be shown, if nothing of the text can be read or it
                is too long.
        """
        words = words_of(text)[:_MAX_WORDS]
        frame, unclear, chance, takes = self._read(words, question or OPENING)
        return Understood(frame, math.exp(chance / self._temperature), unclear, takes=takes)

    def asks(self, understood: Understood) -> bool:
        """Returns whether the system should ask again instead of acting."""
        return understood.confidence < self.threshold or bool(understood.unclear)

    def _read(
        self, words: Sequence[str], question: Frame
    ) -> tuple[Frame, tuple[Unclear, ...], float, float]:
        """Returns the frame of some words, the unclear ones, its log-probability, and the yes's."""
        reading = self._model.read(words, question)
        return *assemble(words, reading, question, self.lexicon), reading.takes

    def save(self, path: str | Path) -> None:
        """Writes the learned parts into one file, in numpy's format without pickles."""
        model = self._model
        about = {
            "format": _FORMAT,
            "domain": self.domain.name,
            "acts": self.domain.acts,
            "slots": self.domain.slots,
            "features": model.net.features,
            "known": sorted(model.features.known),
            "temperature": self._temperature,
        }
        arrays = {name: weight.numpy() for name, weight in model.net.state_dict().items()}
        arrays["bag.weight"] = arrays["bag.weight"].astype(np.float16)
        arrays["tagger"] = np.frombuffer(model.tagger.model, dtype=np.uint8)
        arrays["about"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays)
        write_bytes(Path(path), buffer.getvalue())

    @classmethod
    def load(cls, path: str | Path, domain: Domain) -> Understander:
        """Returns the understander that :meth:`save` wrote.

        Load only your own files, or those of somebody you trust: the zip file's checksums detect
        damage, but a malicious file reaches a C library that does not expect it.

        Args:
            path: the file.
            domain: the domain; its acts and slots must be those that it was trained for.

        Raises:
            FileNotFoundError: if there is no such file.
            ValueError: if it is damaged, or of another format or domain.
        """
        about, arrays = _read_file(Path(path))
        if (about["acts"], about["slots"]) != (list(domain.acts), list(domain.slots)):
            raise ValueError(
                f"{path} understands the domain {about['domain']!r}, whose acts and slots differ "
                f"from those of {domain.name!r}"
            )
        lexicon = Lexicon(domain)
        tagger = Tagger(arrays.pop("tagger").tobytes())
        net = IntentNet(about["features"], (*domain.acts, FOREIGN.act), domain.slots)
        net.load_state_dict(
            {name: torch.from_numpy(array).float() for name, array in arrays.items()}
        )
        model = Model(Features(lexicon, about["known"]), tagger, net.eval())
        return cls(lexicon, model, about["temperature"])


def _read_file(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Returns what a file says about itself, and its other arrays."""
    try:
        # Opened here, since numpy leaves a damaged file open.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = dict(stored)
        about = json.loads(arrays.pop("about").tobytes())
    except FileNotFoundError:
        raise
    except Exception as error:  # whatever zipfile and numpy raise about bytes that are not theirs
        raise ValueError(f"{path} is no file of an understander, or damaged: {error}") from None
    if about["format"] != _FORMAT:
        raise ValueError(f"{path} must be of format {_FORMAT}, got {about['format']}: train again")
    return about, arrays


def same_frame(left: Frame, right: Frame, lexicon: Lexicon) -> bool:
    """Returns whether two frames are equal, comparing values by their canonical keys."""
    return (
        left.act == right.act
        and set(left.requests) == set(right.requests)
        and keys_of(left, lexicon) == keys_of(right, lexicon)
    )


def keys_of(frame: Frame, lexicon: Lexicon) -> dict[str, str]:
    """Returns the canonical key of each value of a frame."""
    return {slot: lexicon.key(slot, value) for slot, value in frame.informs.items()}


def cached_understander(
    domain: Domain,
    labeled: Path | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Understander:
    """Returns the understander of a domain, and trains it if it is not in the cache folder.

    Its file is named after a hash of everything that it is made from.

    Args:
        domain: the domain, with its phrases in its folder; otherwise with the generic phrases.
        labeled: the user's labeled lines, to learn from as well.
        tell: called with a message when training begins, which takes a minute.

    Raises:
        ValueError or OSError: a file that cannot be used.
        ModuleNotFoundError: the extra ``language`` is not installed.
    """
    lines = [] if labeled is None else read_lines(labeled, domain)
    name = f"{language_key(domain, labeled)}.npz"
    with suppress(OSError, RuntimeError, ValueError):
        return Understander.load(_cache_folder() / name, domain)
    tell("Learning the language of the domain, once; it takes about a minute ...")
    own = Understander.train(domain, labeled=lines)
    with suppress(OSError, RuntimeError):  # without a cache folder it is trained each time
        own.save(_cache_folder() / name)
    return own


def _cache_folder() -> Path:
    """Returns the user's cache folder, restricted to its user: its files are trusted.

    Raises:
        RuntimeError: there is no home folder.
        OSError: it cannot be made, or is another user's.
    """
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "bbq-torchrl"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
        raise PermissionError(errno.EPERM, "is another user's", os.fspath(folder))
    folder.chmod(0o700)
    return folder


def language_key(domain: Domain, labeled: Path | None = None) -> str:
    """Returns a hash of everything that the understander and the sentences are made from.

    Args:
        domain: the domain.
        labeled: the user's labeled lines.
    """
    digest = hashlib.sha256(f"{version('bbq-torchrl')} {domain!r}".encode())
    sources = sorted(Path(__file__).parent.glob("*.*"))
    files = (LANGUAGE_FILE, LEARNED_FILE, DRILLED_FILE)
    own = [] if domain.folder is None else [domain.folder / name for name in files]
    for path in (*sources, *own, *([labeled] if labeled is not None else [])):
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()[:24]
