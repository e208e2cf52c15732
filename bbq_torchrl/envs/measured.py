"""Measured errors: counting the errors of sentences for a domain, and loading the counts."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from functools import reduce
from itertools import cycle
from typing import TYPE_CHECKING, Any

import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.domain import RANDOM_POLICY
from bbq_torchrl.envs.dialogue import DialogueEnv
from bbq_torchrl.envs.policies import scripted_policy
from bbq_torchrl.simulator import MeasuredErrors
from bbq_torchrl.simulator.measured_errors import (
    CONTEXTS,
    MAX_REQUESTS,
    context_of,
    questions_of,
)
from bbq_torchrl.utils.seeds import checked_seed
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from tensordict import TensorDictBase
    from tensordict.nn import TensorDictModuleBase

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.envs.text_channel import TextChannel
    from bbq_torchrl.simulator import Utterance
    from bbq_torchrl.simulator.tracker import AgentTurn

ERRORS_FILE = "errors.json"
"""The file of counts in a domain's folder."""

_COMMAND = "bbq language count"
_BATCH = 500
_RANDOM = 0.15  # share of random actions: an agent that learns tries everything


def load_errors(domain: Domain) -> MeasuredErrors:
    """Loads the errors counted for a domain.

    Args:
        domain: the domain, with :data:`ERRORS_FILE` in its folder.

    Raises:
        ValueError: if the file is missing, damaged, or of a domain with other slots.
    """
    file = None if domain.folder is None else domain.folder / ERRORS_FILE
    if file is None or not file.is_file():
        found = f"{domain.name} without a folder" if file is None else f"no {shown(str(file))}"
        raise ValueError(
            f"env.errors=measured needs a domain folder with {ERRORS_FILE}, got {found}: "
            f"`{_COMMAND} --domain <folder>` writes {ERRORS_FILE} into it"
        )
    try:
        counts = json.loads(file.read_text(encoding="utf-8-sig"))
        counted = {slot for row in counts["requests"].values() for slot in row}
        if counted != {*domain.slots}:  # the requests of every turn count all slots
            raise ValueError(f"its slots are {', '.join(sorted(counted))}")
        return MeasuredErrors(tensorize(domain), counts)
    except Exception as error:  # such as JSON nested too deeply or missing counts
        raise ValueError(
            f"{file} is damaged or has the errors of another domain ({error!r}): write it again "
            f"by `{_COMMAND} --domain {file.parent}`"
        ) from error


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
    from bbq_torchrl.envs.text_channel import text_channel  # imports the language layer

    channel = _Recorder(text_channel(domain))
    names = tuple(domain.policies) or (RANDOM_POLICY,)
    halves: list[tuple[Iterable[str | TensorDictModuleBase], float]] = [(names, _RANDOM)]
    if trained:
        halves.append((trained.values(), 0.0))
    seed = checked_seed(seed)
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


def errors_text(counts: Mapping[str, Any]) -> str:
    """Returns the text of :data:`ERRORS_FILE`: JSON with a line for each row of the tables."""
    return f"{_lines(counts, 0)}\n"


def _lines(content: Any, depth: int) -> str:
    is_row = not isinstance(content, dict) or not any(
        isinstance(value, dict) for value in content.values()
    )
    if is_row:
        return json.dumps(content, ensure_ascii=False)
    pad = " " * (depth + 1)
    rows = (
        f"{pad}{json.dumps(key, ensure_ascii=False)}: {_lines(value, depth + 1)}"
        for key, value in content.items()
    )
    return "{\n" + ",\n".join(rows) + "\n" + " " * depth + "}"


class _Recorder:
    """A wrapper of the channel of sentences that counts the utterances."""

    def __init__(self, channel: TextChannel) -> None:
        self._channel = channel
        self.slot_draws, self.draws = channel.slot_draws, channel.draws
        self.mishears_all = channel.mishears_all
        self.turns = 0
        coding = channel.coding
        self._acts, self._slots = coding.acts, coding.slots
        self._questions = questions_of(coding.acts, coding.slots)
        self._text = coding.text
        self._counted: Counter[tuple[str, ...]] = Counter()
        self._requests: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0])

    def to(self, device: torch.device | str) -> _Recorder:
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
        heard = self._channel.transmit(said, agent, before, is_silent, draws, active)
        columns = (
            *context_of(agent, said, len(self._acts)),
            *(said.act, said.informs, said.requests),
            *(heard.act, heard.informs, heard.requests),
        )
        for turn in zip(*(column[~is_silent].tolist() for column in columns), strict=True):
            self._count(*turn)
        return heard

    def _count(
        self,
        question: int,
        asks_or_question: int,
        contexts: list[int],
        act: int,
        informs: list[int],
        requests: list[bool],
        heard_act: int,
        heard_informs: list[int],
        heard_requests: list[bool],
    ) -> None:
        self.turns += 1
        acts, slots, text = self._acts, self._slots, self._text
        manner = "asking" if any(heard_requests) else "silent"
        asked, counted = self._questions[asks_or_question], self._counted
        said_act = f"{self._questions[question]} {acts[act]} {manner}"
        counted["acts", said_act, acts[heard_act]] += 1
        values = list(enumerate(zip(informs, heard_informs, strict=True)))
        lost = [slot for slot, (said, heard) in values if said and not heard]
        new = [slot for slot, (said, heard) in values if heard and not said]
        moved = (lost[0], new[0]) if len(lost) == len(new) == 1 else None
        for slot, (said, _) in values:
            if not said:
                continue
            target = moved[1] if moved and moved[0] == slot else slot
            value = heard_informs[target]
            name = f"{slots[target]}={text(target, value)}" if value else ""
            counted["values", CONTEXTS[contexts[slot]], slots[slot], text(slot, said), name] += 1
        counted["inserted", asked, "turns"] += 1
        for slot in [] if moved else new[:1]:
            name = f"{slots[slot]}={text(slot, heard_informs[slot])}"
            counted["inserted", asked, name] += 1
        count = min(sum(requests), MAX_REQUESTS)
        for slot, name in enumerate(slots):
            said_ = "said" if requests[slot] else "unsaid"
            pair = self._requests[f"{count} {said_} {CONTEXTS[contexts[slot]]}", name]
            pair[0] += heard_requests[slot]
            pair[1] += 1

    def counts(self) -> dict[str, Any]:
        """Returns the counts as plain data, in a deterministic order."""
        counts: dict[str, Any] = {
            "acts": {},
            "values": {context: {} for context in CONTEXTS},
            "inserted": {},
            "requests": {},
        }
        rows: dict[tuple[str, ...], Any] = dict(self._counted)
        rows |= {("requests", *path): pair for path, pair in self._requests.items()}
        for (*above, last), number in sorted(rows.items()):
            reduce(lambda found, key: found.setdefault(key, {}), above, counts)[last] = number
        return counts
