"""Training sentences: frames of every kind, expressed by the domain's grammar."""

from __future__ import annotations

import random
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal, NamedTuple

import torch
from tensordict import TensorDict

from bbq_torchrl.domains import Domain, tensorize
from bbq_torchrl.domains.frames import ANY, AVAILABLE_TEXT, NO_MATCH_TEXT, Coding, Frame
from bbq_torchrl.people.language.asking import OPENING, YES
from bbq_torchrl.people.language.composer import Composer
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.paraphrase import (
    Paraphraser,
    as_second_language,
    slangy,
    with_typos,
)
from bbq_torchrl.people.language.phrases import Piece
from bbq_torchrl.people.language.words import ENGLISH, OUTSIDE, tokenize
from bbq_torchrl.simulator import Simulator

_SLOTLESS = tuple(
    "greeting thanks deny confirm_answer not_sure closing welcome request inform confirm_question "
    "multiple_choice".split()
)
_SMALL_WORDS = frozenset(("in", "or", "ok", "hi", "me", "oh"))
_DIALOGUES = 1_000
_KEPT = 100  # of 500
_Count = int | list[int]


_BATCH = 500


@dataclass(frozen=True)
class Example:
    """A sentence with its meaning.

    Attributes:
        words: the words, see :func:`~bbq_torchrl.people.language.words.tokenize`.
        tags: the slot whose value each word is part of, else :data:`OUTSIDE`.
        frame: the meaning.
        question: the agent's last act; :data:`OPENING` before its first.
        takes: whether it takes what the agent offers or proposes, whatever else it says.
    """

    words: list[str]
    tags: list[str]
    frame: Frame
    question: Frame
    takes: bool = False


def tag(pieces: Sequence[Piece]) -> tuple[list[str], list[str]]:
    """Returns the words of pieces and their tags."""
    words: list[str] = []
    tags: list[str] = []
    for slot, together in groupby(pieces, key=lambda piece: piece.slot):
        own = tokenize("".join(piece.text for piece in together))
        words += own
        tags += [OUTSIDE if slot is None else slot] * len(own)
    return words, tags


def make_examples(
    lexicon: Lexicon,
    count: int,
    seed: int,
    *,
    noise: float = 1.0,
    simulated: bool = False,
) -> list[Example]:
    """Returns sentences of the domain's grammar.

    Args:
        lexicon: the domain's phrases and values.
        count: the number of sentences.
        seed: the seed of all random choices.
        noise: scales the probability that a sentence is spoiled.
        simulated: whether the acts are those of simulated users, who ask several things at once.
    """
    rng = random.Random(seed)
    # Not the dialogues of the round-trip measurement.
    other = seed + 1_000_000
    turns = play(lexicon.domain, _DIALOGUES, seed=other, kept=_KEPT) if simulated else []
    frames = _Frames(lexicon)
    composer = Composer(lexicon, simulated=simulated)
    paraphrase = Paraphraser(lexicon)
    examples: list[Example] = []
    while len(examples) < count:
        question, frame = rng.choice(turns) if simulated else frames.draw(rng)
        is_clear = simulated and rng.random() < 0.5
        words, tags = tag(composer.compose(frame, question, rng, paraphrase, is_clear=is_clear))
        own = Example(words, tags, frame, question or OPENING, frame.act in YES)
        example = _spoil(own, rng, noise)
        if example.words and len(example.words) <= 60:
            examples.append(example)
    return examples


def spoiled(examples: Sequence[Example], seed: int) -> list[Example]:
    """Returns people's sentences, spoiled like the grammar's."""
    rng = random.Random(seed)
    return [_spoil(example, rng, 1.0) for example in examples]


def _spoil(example: Example, rng: random.Random, noise: float) -> Example:
    tagged = list(zip(example.words, example.tags, strict=True))
    if rng.random() < 0.5 * noise:
        tagged = [
            (w, t)
            for w, t in tagged
            if t != OUTSIDE or w.isalnum() or "'" in w or rng.random() < 0.15
        ]
    if rng.random() < 0.3 * noise:
        tagged = as_second_language(tagged, rng)
    if rng.random() < 0.15 * noise:
        tagged = slangy(tagged, rng)
    words = [word for word, _ in tagged]
    if rng.random() < 0.35 * noise:
        words = with_typos(words, 0.12, rng)
    return replace(example, words=words, tags=[tag for _, tag in tagged])


def _shapes(lexicon: Lexicon, slot: str) -> tuple[list[list[str]], list[float]]:
    """Returns the values of a slot by the shape of their keys, and the weight of each shape."""
    shapes: dict[str, list[str]] = {}
    for value in lexicon.values(slot):
        key = lexicon.key(slot, value)
        is_read = lexicon.kinds[slot] != "text" and any(letter.isdigit() for letter in key)
        shapes.setdefault(re.sub(r"\d+", "0", key) if is_read else "", []).append(value)
    return list(shapes.values()), [len(values) ** 0.5 for values in shapes.values()]


class _Row(NamedTuple):
    """A kind of reply: its weight, its act, what it says of the slot spoken of, and more slots.

    An act that the domain lacks stands for any act without slots.
    """

    weight: int
    act: str
    own: Literal["", "value", "any", "asks"] = ""
    requests: _Count = 0
    values: _Count = 0


_REPLIES = {kind: [_Row(*row) for row in rows] for kind, rows in ENGLISH["replies"].items()}


class _Frames:
    """Draws an agent's act and a user's reply."""

    def __init__(self, lexicon: Lexicon) -> None:
        domain = lexicon.domain
        self._domain, self._lexicon = domain, lexicon
        self._slotless = [act for act in _SLOTLESS if act in domain.acts]
        goals = len(domain.goals)
        requested = [s for goal in domain.goals for s in goal.requests]
        told = [a.slot for a in domain.actions if a.kind == "inform" and a.slot]
        asked = [a.slot for a in domain.actions if a.kind == "request" and a.slot]
        constrained = [s for goal in domain.goals for s in goal.constraints]
        self._asked = [s for s in asked if s in lexicon.slots]
        self._told = [s for s in told if s in lexicon.slots]
        wanted = dict.fromkeys((*requested, *told, *asked))
        wanted.pop(domain.complete_slot, None)
        self._wanted = {slot: 1.0 + 3.0 * (requested.count(slot) / goals) ** 0.5 for slot in wanted}
        self._wanted[domain.ticket_slot] = 6.0
        self._valued = {
            slot: 0.35 + 2.0 * (constrained.count(slot) / goals) ** 0.5 for slot in lexicon.slots
        }
        self._wishes = {
            slot: [g.constraints[slot] for g in domain.goals if g.constraints.get(slot, ANY) != ANY]
            for slot in lexicon.slots
        }
        self._shapes = {slot: _shapes(lexicon, slot) for slot in lexicon.slots}

    def draw(self, rng: random.Random) -> tuple[Frame, Frame]:
        """Returns the agent's last act and the user's act."""
        can_ask, can_tell = 38 * bool(self._asked), 13 * bool(self._told)
        kind = rng.choices("oaivct", (32, can_ask, can_tell, 10, 5, 2))[0]
        if kind == "o":
            return OPENING, self._reply("opening", rng)
        if kind == "a":
            slot = rng.choices(self._asked, [self._valued[s] for s in self._asked])[0]
            return Frame("request", {}, (slot,)), self._reply("answer", rng, slot)
        if kind == "i":
            slot = rng.choice(self._told)
            value = NO_MATCH_TEXT if rng.random() < 0.2 else self._value(slot, rng)
            return Frame("inform", {slot: value}), self._reply("reaction", rng, slot)
        if kind == "c":
            act = rng.choice(("greeting", "deny", "confirm_question", "confirm_answer"))
            return Frame(act), self._reply(act if act in _REPLIES else "reaction", rng)
        verdict = rng.choice((AVAILABLE_TEXT, NO_MATCH_TEXT))
        if kind == "t":
            ticket = Frame("inform", {self._domain.ticket_slot: verdict})
            return ticket, self._reply("reaction", rng)
        complete = {self._domain.complete_slot: verdict}
        offer = self._frame("inform", rng, complete, values=[1, 2, 3, 4])
        slot = rng.choice([slot for slot in offer.informs if slot in self._valued])
        return offer, self._reply("verdict", rng, slot)

    def _reply(self, kind: str, rng: random.Random, slot: str | None = None) -> Frame:
        """Returns a user's reply of a kind; ``slot`` is that of the agent's act."""
        rows = [row for row in _REPLIES[kind] if slot is not None or not row.own]
        row = rng.choices(rows, [row.weight for row in rows])[0]
        if row.act not in self._domain.acts:
            return Frame(rng.choice(self._slotless))
        but = () if slot is None else (slot,)
        frame = self._frame(row.act, rng, requests=row.requests, values=row.values, but=but)
        if slot is None or not row.own:
            return frame
        if row.own == "asks":
            return replace(frame, requests=(slot,)) if slot in self._wanted else frame
        own = self._value(slot, rng) if row.own == "value" else ANY
        return replace(frame, informs={slot: own, **frame.informs})

    def _value(self, slot: str, rng: random.Random) -> str:
        """Returns a value; rare shapes ("after work") come up more often than their share."""
        if self._wishes.get(slot) and rng.random() < 0.35:
            return rng.choice(self._wishes[slot])
        shapes, weights = self._shapes[slot]
        value = rng.choice(rng.choices(shapes, weights)[0])
        return rng.choice(self._lexicon.values(slot)) if value in _SMALL_WORDS else value

    def _drawn(
        self, weights: Mapping[str, float], rng: random.Random, count: _Count, but: Sequence[str]
    ) -> list[str]:
        """Returns slots drawn by weight with replacement, except those in ``but``."""
        size = count if isinstance(count, int) else rng.choice(count)
        slots = [slot for slot in weights if slot not in but]
        return rng.choices(slots, [weights[slot] for slot in slots], k=size) if slots else []

    def _frame(
        self,
        act: str,
        rng: random.Random,
        told: Mapping[str, str] | None = None,
        *,
        requests: _Count = 0,
        values: _Count = 0,
        but: tuple[str, ...] = (),
    ) -> Frame:
        """Returns an act with random questions and values of different slots, none in ``but``.

        Args:
            act: the act.
            rng: the random number generator.
            told: further values to inform.
            requests: the number of questions, or a list to draw it from.
            values: the number of values, or a list to draw it from.
            but: the slots to leave out.
        """
        asked = tuple(dict.fromkeys(self._drawn(self._wanted, rng, requests, but)))
        slots = self._drawn(self._valued, rng, values, (*but, *asked))
        drawn = {slot: self._value(slot, rng) for slot in slots}
        return Frame(act, {**(told or {}), **drawn}, asked)


def play(
    domain: Domain, dialogues: int, *, seed: int = 0, kept: int = 4
) -> list[tuple[Frame | None, Frame]]:
    """Returns the acts of dialogues with agents that are half scripted, half random.

    Args:
        domain: the domain.
        dialogues: the number of dialogues, rounded up to whole batches.
        seed: the seed of users and agents.
        kept: the number of dialogues of a batch to record at each turn.

    Returns:
        The agent's act, ``None`` at the opening, and the user's act that follows.
    """
    tensors = tensorize(domain)
    simulator = Simulator(tensors)
    active = torch.ones(tensors.n_slots, dtype=torch.bool)
    generator = torch.Generator().manual_seed(seed)
    scripts = [p.steps for p in domain.policies.values() if p.kind == "script"]
    coding = Coding(tensors)
    ends = torch.tensor([action.act in ("thanks", "closing") for action in domain.actions])
    found = []
    for number in range(-(-dialogues // _BATCH)):
        state = simulator.reset(simulator.draw_reset((_BATCH,), generator), active)
        found += _frames(coding, state[:kept])
        steps = scripts[number % len(scripts)] if scripts else ()
        for turn in range(simulator.max_agent_turns):
            action = torch.randint(tensors.n_actions, (_BATCH,), generator=generator)
            is_early = torch.rand(_BATCH, generator=generator) > turn / 15
            action = torch.where(is_early & ends[action], tensors.n_actions - 1, action)
            if turn < len(steps):
                follows = torch.rand(_BATCH, generator=generator) < 0.6
                action = torch.where(follows, domain.action_index(steps[turn]), action)
            was_done = state["done"]
            state = simulator.turn(state, action, simulator.draw_turn((_BATCH,), generator), active)
            found += _frames(coding, state[~was_done][:kept])
            if bool(state["done"].all()):
                break
    return found


def _frames(coding: Coding, states: TensorDict) -> list[tuple[Frame | None, Frame]]:
    """Returns the agent's act and the user's act in each of the states ``[B]``."""

    def side(*keys: str) -> list[Frame]:
        columns = [states[key].tolist() for key in keys]
        return [coding.frame(*row) for row in zip(*columns, strict=True)]

    users = side("user_act", "meant_informs", "pending")
    agents = side("agent_act", "agent_informs", "agent_requests")
    acts = states["agent_act"].tolist()
    return [
        (None if act < 0 else agent, user)
        for act, agent, user in zip(acts, agents, users, strict=True)
    ]
