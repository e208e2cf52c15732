"""Dialogues at the level of text: users' acts become sentences, which the nlu understands.

Counting what the nlu mishears gives the tables of
:class:`~bbq_torchrl.simulator.MeasuredErrors`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from bbq_torchrl.domains import Domain, DomainTensors, tensorize
from bbq_torchrl.domains.domain import RANDOM_POLICY
from bbq_torchrl.domains.frames import Coding
from bbq_torchrl.domains.tensors import index_below
from bbq_torchrl.envs.dialogue import DialogueEnv
from bbq_torchrl.envs.policies import scripted_policy
from bbq_torchrl.people.language import Frame, Generator, TextError, Understander, Understood
from bbq_torchrl.people.language.asking import Asking, repeated
from bbq_torchrl.people.language.understander import cached_understander
from bbq_torchrl.simulator import Utterance
from bbq_torchrl.simulator.measured_errors import ERRORS_FILE, ErrorCounter
from bbq_torchrl.simulator.tracker import AgentTurn
from bbq_torchrl.utils.files import write_text
from bbq_torchrl.utils.seeds import checked_seed

VARIANTS = 16
"""The number of wordings of an act."""

_CACHE_SIZE = 200_000
_BATCH = 500
_RANDOM = 0.15  # share of random actions: an agent that learns tries everything
_BEFORE = -1


class TextChannel:
    """The channel of sentences: the user's act is generated as a sentence and understood from it.

    The domain's grammar generates the sentence in a random wording. The nlu interprets it in the
    context of the agent's act, as in a chat, and the system asks again by the same rule
    (:class:`~bbq_torchrl.people.language.asking.Asking`). The user then repeats the act in other
    words, or the one value asked about, and each repetition takes a turn.

    A value understood in another spelling ("7:30pm", "7:30 pm") counts as the value said: corpora
    spell values in several ways, which is not a misunderstanding. Results are cached by act,
    wording and the agent's act before.

    The channel loops over the dialogues, so it is meant for evaluation. Neither it nor an
    environment with it can be pickled; give other processes the function that makes them.

    Args:
        domain: the domain's tensors.
        understand: the nlu.
        speak: the nlg of the users.
        ask_below: the confidence below which the system asks again, between 0 (never) and 1;
            ``None`` for the default of the nlu.

    Attributes:
        coding: the ids of frames.
    """

    slot_draws: tuple[str, ...] = ()
    draws: tuple[str, ...] = ("words",)
    mishears_all = True

    def __init__(
        self,
        domain: DomainTensors,
        understand: Understander,
        speak: Generator,
        ask_below: float | None = None,
    ) -> None:
        self._understand, self._speak, self._ask_below = understand, speak, ask_below
        self._act = domain.act
        self.coding = Coding(domain)
        self._heard = lru_cache(maxsize=_CACHE_SIZE)(self._hear)

    def to(self, device: torch.device | str) -> TextChannel:
        """Returns itself: utterances are created on the device of the users' acts."""
        return self

    def transmit(
        self,
        said: Utterance,
        agent: AgentTurn | None,
        before: torch.Tensor,
        is_silent: torch.Tensor,
        draws: TensorDictBase,
        active: torch.Tensor,
    ) -> Utterance:
        """Returns the utterance heard; see :class:`~bbq_torchrl.simulator.Channel`."""
        n_slots, shape = said.informs.shape[-1], said.act.shape
        parts = [said.act[..., None], said.informs, said.requests]
        if agent is not None:
            parts += [agent.act[..., None], agent.informs, agent.requests]
        words = index_below(draws["words"], VARIANTS)
        row = torch.cat([words[..., None], *parts], -1)
        rows = row.reshape(-1, row.shape[-1]).int().cpu().numpy()  # all numbers fit into 32 bits
        found = torch.zeros(len(rows), 2 + 2 * n_slots, dtype=torch.long)
        for number in (~is_silent).flatten().nonzero().flatten().tolist():
            found[number] = self._heard(rows[number].tobytes())
        found = found.view(*shape, -1).to(said.act.device)
        repeats, act, informs, requests = found.split([1, 1, n_slots, n_slots], -1)
        act = act.squeeze(-1)
        act = torch.where(act == _BEFORE, before, act)
        return Utterance(
            torch.where(is_silent, said.act, act),
            informs * active,
            torch.where(is_silent[..., None], said.requests, requests.bool() & active),
            repeats.squeeze(-1),
        )

    def _hear(self, row: bytes) -> torch.Tensor:
        """Returns the utterance heard, long ``[2 + 2 S]``: repeats, act, informs, requests."""
        coding, key = self.coding, self._understand.lexicon.key
        words, *numbers = np.frombuffer(row, dtype=np.int32).tolist()
        n_slots = len(coding.slots)
        width = 1 + 2 * n_slots
        frame, *questions = (
            coding.frame(part[0], part[1 : 1 + n_slots], part[1 + n_slots :])
            for part in (numbers[at : at + width] for at in range(0, len(numbers), width))
        )
        question = questions[0] if questions else None
        asking, said = Asking(), frame
        while True:
            text = self._speak.user(said, question, session=words, turn=asking.times)
            try:
                understood = self._understand(text, asking.question(question))
            except TextError:  # unreadable text has no content
                understood = Understood(Frame("not_sure"), 0.0)
            if not asking.asks(self._understand, understood, self._ask_below):
                break
            asking = asking.again(understood)
            said = repeated(frame, (asking.slot,) if understood.unclear else ())
        heard = asking.joined(understood.frame)
        informs = dict(heard.informs)
        for slot, value in frame.informs.items():
            if slot in informs and key(slot, informs[slot]) == key(slot, value):
                informs[slot] = value
        act = coding.act(heard, question, "")
        return torch.tensor(
            [
                asking.times,
                self._act.get(act, _BEFORE),
                *coding.ids(informs),
                *coding.flags(heard.requests),
            ]
        )


def text_channel(domain: Domain, ask_below: float | None = None) -> TextChannel:
    """Returns the channel of sentences of a domain.

    If the user's cache folder lacks the domain's nlu, training it takes about a minute.

    Args:
        domain: the domain, with phrases in its folder; otherwise generic phrases are used.
        ask_below: the confidence below which the system asks again; see :class:`TextChannel`.

    Raises:
        ModuleNotFoundError: if the extra ``language`` is not installed.
    """
    understand = cached_understander(domain)
    speak = Generator(domain)
    return TextChannel(tensorize(domain), understand, speak, ask_below)


def count_errors(
    domain: Domain,
    turns: int,
    *,
    seed: int = 0,
    trained: Mapping[str, TensorDictModuleBase] | None = None,
) -> dict[str, Any]:
    """Counts what is said and heard in simulated dialogues at the level of text.

    The domain's scripted policies play half of the turns, one after another, with a share of random
    actions. Trained agents play the other half without random actions: no script informs users as
    they do, and is corrected as they are.

    Args:
        domain: the domain.
        turns: the least number of user turns to count.
        seed: seed of all random numbers.
        trained: policies of trained agents, of one replica, by name. Without them the scripted
            policies play all turns.
    """
    seed = checked_seed(seed)
    channel = ErrorCounter(text_channel(domain), tensorize(domain))
    names = tuple(domain.policies) or (RANDOM_POLICY,)
    halves: list[tuple[Iterable[str | TensorDictModuleBase], float]] = [(names, _RANDOM)]
    if trained:
        halves.append((trained.values(), 0.0))
    generator = torch.Generator().manual_seed(seed)
    number = 0
    for half, (policies, random) in enumerate(halves, 1):
        for policy in cycle(policies):
            if channel.turns >= turns * half / len(halves):
                break
            env = DialogueEnv(domain, batch_size=(1, _BATCH), channel=channel, seed=seed + number)
            module = scripted_policy(policy, env) if isinstance(policy, str) else policy
            _play(env, module, random, generator)
            number += 1
    return {
        "domain": domain.name,
        "seed": seed,
        "trained": list(trained or ()),
        "turns": channel.turns,
        **channel.counts(),
    }


def _play(
    env: DialogueEnv, policy: TensorDictModuleBase, random: float, generator: torch.Generator
) -> None:
    """Plays the environment's dialogues to their end, with a share of random actions."""
    shape, actions = env.batch_size, env.domain.actions
    ends = torch.tensor([action.act in ("thanks", "closing") for action in actions])
    state = env.reset()
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        while not bool(state["done"].all()):
            action = policy(state)["action"]
            other = torch.randint(len(actions), shape, generator=generator)
            is_random = torch.rand(shape, generator=generator) < random
            # Random actions seldom end a dialogue, because late turns are needed too.
            is_random &= ~ends[other] | (torch.rand(shape, generator=generator) < random)
            state["action"] = torch.where(is_random, other, action)
            state = step_mdp(env.step(state))


def save_errors(folder: Path, counts: Mapping[str, Any]) -> Path:
    """Writes counts as JSON into a domain's folder."""
    file = folder / ERRORS_FILE
    write_text(file, json.dumps(counts, ensure_ascii=False, indent=1) + "\n")
    return file
