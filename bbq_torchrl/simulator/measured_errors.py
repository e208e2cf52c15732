"""Error rates measured on sentences, counted and applied to dialogue acts as tensors."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from bbq_torchrl.domains import Domain, DomainTensors
from bbq_torchrl.domains.frames import Coding, Frame
from bbq_torchrl.domains.tensors import Movable, one_hot, rows, tensorize
from bbq_torchrl.domains.values import NONE, fold, value_ids
from bbq_torchrl.simulator.error_model import ABOVE_IDS, Channel
from bbq_torchrl.simulator.tracker import AgentTurn, Utterance
from bbq_torchrl.utils.text import shown

CONTEXTS = ("opening", "asked", "beside", "corrected", "told")
"""The contexts in which a user mentions a slot: the opening; after the agent has requested the
slot; has requested another slot; has informed the slot; any other."""

ERRORS_FILE = "errors.json"
"""The file of counts in a domain's folder."""

_COMMAND = "bbq language count"

MAX_REQUESTS = 3
"""Turns with this many requests or more count as one kind."""

_MEAN_WEIGHT = 2.0  # pseudo-counts of the slot's mean rates, added to the counts of a value


class MeasuredErrors(Movable):
    """The channel of sentences as a table of counts: utterances said and heard.

    Each turn draws the following independently, given the user's utterance and the agent's act
    before it:

    - each value is kept, changed, dropped, or moved to another slot, by slot, value and context
      (:data:`CONTEXTS`). Two pseudo-counts with the slot's mean rates are added, in which values
      are either kept or dropped;
    - an additional value may be heard, by the slot that the agent has requested, or by its act if
      it was not a request;
    - each slot is heard as requested or not, by slot, context, whether the user requests it, and
      the number of slots that the user requests;
    - an act is heard, by the user's act, the agent's act, and whether any request was heard.

    Args:
        domain: the domain's tensors.
        counts: the counts that ``bbq language count`` writes.

    Raises:
        KeyError, TypeError or ValueError: if the counts are damaged or of another domain.
    """

    slot_draws: tuple[str, ...] = ("slot_error", "request_error")
    draws: tuple[str, ...] = ("act_error", "insertion")
    mishears_all = True

    def __init__(self, domain: DomainTensors, counts: Mapping[str, Any]) -> None:
        self._n_acts, self._n_slots = domain.n_acts, domain.n_slots
        self._names = tuple(domain.slot)
        self._slot = domain.slot
        self._ids = value_ids(domain.vocabulary)
        self._first = domain.n_values.cumsum(0) - domain.n_values
        self._slots = torch.arange(domain.n_slots)
        self._value_rows(domain, counts["values"])
        questions = questions_of(tuple(domain.act), self._names)
        self._insertion_rows(counts["inserted"], questions)
        self._request_rates(counts["requests"])
        found = [
            counts["acts"].get(f"{question} {act} {heard}", {act: 1})
            for question in questions[: self._n_acts + 2]
            for act in domain.act
            for heard in ("asking", "silent")
        ]
        self._act_below, self._act_codes = _table(
            [[(domain.act[act], float(count)) for act, count in row.items()] for row in found]
        )

    def transmit(
        self,
        said: Utterance,
        agent: AgentTurn | None,
        before: Tensor,
        is_silent: Tensor,
        draws: TensorDictBase,
        active: Tensor,
    ) -> Utterance:
        """Returns the utterance heard; see :class:`~bbq_torchrl.simulator.Channel`."""
        question, asks_or_question, context = context_of(agent, said, self._n_acts)
        informs = self._hear_values(said.informs, context, asks_or_question, draws) * active
        requests = self._hear_requests(said.requests, context, draws) & active
        row = (question * self._n_acts + said.act) * 2 + (~requests.any(-1)).long()
        act = _drawn(self._act_below, self._act_codes, row, draws["act_error"])
        return Utterance(
            torch.where(is_silent, said.act, act),
            torch.where(is_silent[..., None], said.informs, informs),
            torch.where(is_silent[..., None], said.requests, requests),
        )

    def _hear_values(
        self, informs: Tensor, context: Tensor, asks_or_question: Tensor, draws: TensorDictBase
    ) -> Tensor:
        """Returns the values heard, long ``[*B, S]``."""
        row = context * self._n_rows + self._first + informs
        code = _drawn(self._value_below, self._value_codes, row, draws["slot_error"])
        slot, value = code // ABOVE_IDS, code % ABOVE_IDS
        is_same_slot = slot == self._slots
        heard = torch.where(is_same_slot, value, NONE)
        moved = torch.zeros_like(value)
        moved = moved.scatter_reduce(-1, slot, torch.where(is_same_slot, NONE, value), "amax")
        heard = torch.where(heard == NONE, moved, heard)
        below, codes = self._insertion_below, self._insertion_codes
        code = _drawn(below, codes, asks_or_question, draws["insertion"])
        is_new = one_hot(code // ABOVE_IDS, self._n_slots) & (heard == NONE)
        return torch.where(is_new, (code % ABOVE_IDS)[..., None], heard)

    def _hear_requests(self, requests: Tensor, context: Tensor, draws: TensorDictBase) -> Tensor:
        """Returns the slots heard as requested, bool ``[*B, S]``."""
        count = requests.sum(-1, keepdim=True).clamp(max=MAX_REQUESTS)
        row = (count * 2 + requests.long()) * len(CONTEXTS) + context
        row = row * self._n_slots + self._slots
        return draws["request_error"] < self._request_rate.take(row)

    # -- reading the counts ----------------------------------------------------------------------

    def _code(self, slot: str, value: str) -> int:
        """Encodes a slot and a value of it as one number."""
        number = self._slot[slot]
        return number * ABOVE_IDS + (self._ids[number][fold(value)] if value else NONE)

    def _value_rows(self, domain: DomainTensors, counts: Mapping[str, Any]) -> None:
        self._n_rows = int(domain.n_values.sum())
        table = []
        for context in CONTEXTS:
            for slot, ids in zip(self._names, self._ids, strict=True):
                counted = {
                    self._code(slot, value): {
                        self._code(*heard.split("=", 1)) if heard else self._code(slot, ""): number
                        for heard, number in found.items()
                    }
                    for value, found in counts[context].get(slot, {}).items()
                }
                total = sum(sum(found.values()) for found in counted.values())
                kept = sum(found.get(own, 0) for own, found in counted.items())
                mean = kept / total if total else 1.0
                for value in ids:
                    own, lost = self._code(slot, value), self._code(slot, "")
                    row = {lost: _MEAN_WEIGHT * (1.0 - mean), own: _MEAN_WEIGHT * mean}
                    for code, number in counted.get(own, {}).items():
                        row[code] = row.get(code, 0.0) + number
                    table.append([(lost, 1.0)] if own == lost else list(row.items()))
        self._value_below, self._value_codes = _table(table)

    def _insertion_rows(self, counts: Mapping[str, Any], questions: tuple[str, ...]) -> None:
        table = []
        for question in questions:
            found = dict(counts.get(question, {}))
            turns = float(found.pop("turns", 1))
            row = [(self._code(*heard.split("=", 1)), float(n)) for heard, n in found.items()]
            nothing = (self._n_slots * ABOVE_IDS, turns - sum(n for _, n in row))
            table.append([nothing, *row])
        self._insertion_below, self._insertion_codes = _table(table)

    def _request_rates(self, counts: Mapping[str, Any]) -> None:
        rates = [
            _rate(counts.get(f"{count} {said} {context}", {}), said == "said", self._names)
            for count in range(MAX_REQUESTS + 1)
            for said in ("unsaid", "said")
            for context in CONTEXTS
        ]
        self._request_rate = torch.tensor(rates, dtype=torch.float32).flatten()


def questions_of(acts: Sequence[str], slots: Sequence[str]) -> tuple[str, ...]:
    """Returns the possible agent turns before a user's: no turn, an act, an offer or a request."""
    return ("opening", *acts, "offer", *(f"request({slot})" for slot in slots))


def context_of(
    agent: AgentTurn | None, said: Utterance, n_acts: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Returns the context in which users speak.

    Args:
        agent: the agent's act before; ``None`` at the opening.
        said: the users' utterance.
        n_acts: number of acts.

    Returns:
        The index in :func:`questions_of` of the agent's act or offer, long ``[*B]``; the same with
        requests distinguished by slot; and each slot's index in :data:`CONTEXTS`, long
        ``[*B, S]``.
    """
    if agent is None:
        nothing = torch.zeros_like(said.act)
        return nothing, nothing, torch.zeros_like(said.informs)
    question = torch.where(agent.is_booking, n_acts + 1, agent.act + 1)
    asks_or_question = torch.where(agent.is_request, agent.slot + n_acts + 2, question)
    told = agent.is_slot & agent.is_inform[..., None]
    context = torch.where(told, 3, torch.where(agent.is_request[..., None], 2, 4))
    return question, asks_or_question, torch.where(agent.requests, 1, context)


def _rate(found: Mapping[str, Sequence[int]], is_said: bool, slots: Sequence[str]) -> list[float]:
    """Returns the rate at which each slot is heard as requested; the mean rate without counts."""
    heard, turns = (sum(pair[part] for pair in found.values()) for part in (0, 1))
    mean = heard / turns if turns else float(is_said)
    return [found[slot][0] / found[slot][1] if slot in found else mean for slot in slots]


def _table(found: Sequence[Sequence[tuple[int, float]]]) -> tuple[Tensor, Tensor]:
    """Returns cumulative probabilities and codes ``[rows, most]`` of weighted codes."""
    weights = pad_sequence(
        [torch.tensor([weight for _, weight in row], dtype=torch.float64) for row in found], True
    )
    codes = pad_sequence([torch.tensor([code for code, _ in row]) for row in found], True)
    below = weights.cumsum(-1) / weights.sum(-1, keepdim=True)
    for number, row in enumerate(found):
        below[number, len(row) - 1 :] = 1.0  # rounding never selects an entry beyond the last
    return below.float(), codes


def _drawn(below: Tensor, codes: Tensor, row: Tensor, uniform: Tensor) -> Tensor:
    """Draws a code from each row's distribution. Returns long, shape of ``row``."""
    choice = (uniform[..., None] >= rows(below, row)).sum(-1)
    return codes.flatten().take(row * codes.shape[-1] + choice)


def load_errors(domain: Domain) -> MeasuredErrors:
    """Loads the errors counted for a domain.

    Args:
        domain: the domain, with :data:`ERRORS_FILE` in its folder.

    Raises:
        ValueError: if the file is missing, damaged, or of a domain with other slots.
    """
    file = None if domain.folder is None else domain.folder / ERRORS_FILE
    if file is None or not file.is_file():
        raise ValueError(
            f"env.errors=measured needs {ERRORS_FILE} in the domain's folder, got "
            f"{shown(str(domain.folder))}: `{_COMMAND} --domain <folder>` writes it there"
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


class ErrorCounter:
    """A channel that counts what another one mishears, for :class:`MeasuredErrors`.

    Args:
        channel: the other channel.
        domain: the domain's tensors.

    Attributes:
        turns: the number of utterances counted.
    """

    def __init__(self, channel: Channel, domain: DomainTensors) -> None:
        self._channel = channel
        self.slot_draws, self.draws = channel.slot_draws, channel.draws
        self.mishears_all = channel.mishears_all
        self.turns = 0
        self._coding = Coding(domain)
        self._questions = questions_of(self._coding.acts, self._coding.slots)
        self._counted: Counter[tuple[str, ...]] = Counter()
        self._requests: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0])

    def to(self, device: torch.device | str) -> ErrorCounter:
        """Returns itself: counting takes place on the CPU."""
        return self

    def transmit(
        self,
        said: Utterance,
        agent: AgentTurn | None,
        before: Tensor,
        is_silent: Tensor,
        draws: TensorDictBase,
        active: Tensor,
    ) -> Utterance:
        """Returns the utterance heard, and counts it."""
        heard = self._channel.transmit(said, agent, before, is_silent, draws, active)
        columns = (
            *context_of(agent, said, len(self._coding.acts)),
            *(said.act, said.informs, said.requests),
            *(heard.act, heard.informs, heard.requests),
        )
        rows = zip(*(column[~is_silent].tolist() for column in columns), strict=True)
        for question, asked, contexts, *frames in rows:
            self._count(
                self._questions[question],
                self._questions[asked],
                {s: CONTEXTS[c] for s, c in zip(self._coding.slots, contexts, strict=True)},
                self._coding.frame(*frames[:3]),
                self._coding.frame(*frames[3:]),
            )
        return heard

    def _count(
        self, question: str, asked: str, contexts: Mapping[str, str], said: Frame, heard: Frame
    ) -> None:
        self.turns += 1
        counted = self._counted
        manner = "asking" if heard.requests else "silent"
        counted["acts", f"{question} {said.act} {manner}", heard.act] += 1
        lost = [slot for slot in said.informs if slot not in heard.informs]
        new = [slot for slot in heard.informs if slot not in said.informs]
        moved = {lost[0]: new[0]} if len(lost) == len(new) == 1 else {}
        names = {slot: f"{slot}={value}" for slot, value in heard.informs.items()}
        for slot, value in said.informs.items():
            name = names.get(moved.get(slot, slot), "")
            counted["values", contexts[slot], slot, value, name] += 1
        counted["inserted", asked, "turns"] += 1
        for slot in [] if moved else new[:1]:
            counted["inserted", asked, names[slot]] += 1
        count = min(len(said.requests), MAX_REQUESTS)
        for slot, context in contexts.items():
            manner = "said" if slot in said.requests else "unsaid"
            pair = self._requests[f"{count} {manner} {context}", slot]
            pair[0] += slot in heard.requests
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
