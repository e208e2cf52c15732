"""Policies that do not learn: scripts, forms, repair, random actions; one reads the goal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import index

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from bbq_torchrl.domains import Domain
from bbq_torchrl.domains.domain import PRIVILEGED_POLICY, RANDOM_POLICY
from bbq_torchrl.domains.values import DONT_CARE, NONE
from bbq_torchrl.simulator.knowledge_base import pack, popcount


class ClairvoyantPolicy(TensorDictModuleBase):
    """A policy that knows the user's goal and everything that was misheard.

    It reads ``env.dialogues``, the simulator's state, which agents do not observe. It serves as a
    reference, not as a demonstration. Each turn it takes the first action with a reason:

    1. Constraints are unsaid and a question is open: request the question's slot, which makes the
       user inform all unsaid constraints at once.
    2. A constraint is unsaid or was misheard: request it. If an unsaid one cannot be requested,
       ``confirm_answer`` makes the user continue.
    3. An error has filled a slot outside the goal: request it.
    4. A question is open: answer it. Of several questions, the first is the one whose answer leaves
       the most records with values for all the others.
    5. Nothing has been offered yet: offer the booking.
    6. End the dialogue.

    It is not proven to be optimal: it does not wait for errors that happen to help. Goals whose
    constraints and questions no single record meets can only succeed through an error.

    Args:
        env: the :class:`~bbq_torchrl.envs.DialogueEnv`, with or without transforms, that the policy
            plays in. It cannot play in another one or in a copy.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> from bbq_torchrl.envs import DialogueEnv
        >>> env = DialogueEnv(movie_domain(), batch_size=(100,), slot_error_prob=0.0, seed=0)
        >>> rollout = env.rollout(21, ClairvoyantPolicy(env), break_when_any_done=False)
        >>> bool(rollout["next", "success"].any(1).double().mean() > 0.7)
        True
    """

    def __init__(self, env: EnvBase) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["action_mask"], ["action"]
        domain, tensors = env.domain, env.simulator.domain
        names = domain.action_names
        self._request = _actions_of_slots(names, "request", domain.slots).to(env.device)
        self._inform = _actions_of_slots(names, "inform", domain.slots).to(env.device)
        # These two are booked and offered, not answered.
        self._inform[[tensors.ticket, tensors.complete]] = -1
        self._offer = domain.action_index(f"inform({domain.complete_slot})")
        self._end = names.index("thanks" if "thanks" in names else "closing")
        self._continue = names.index("confirm_answer") if "confirm_answer" in names else self._offer
        self._ticket, self._complete = tensors.ticket, tensors.complete
        self._constrains = tensors.constrains
        self._knowledge_base = env.simulator.knowledge_base
        self._records_with = pack((tensors.records != NONE).t())
        # In a closure, because an environment is a module and would become a submodule.
        self._dialogues = lambda: env.dialogues

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the next action."""
        state = self._dialogues()
        is_legal = tensordict.get("action_mask")
        may_request, may_inform = _legal(is_legal, self._request), _legal(is_legal, self._inform)
        constraints, held, agenda = state["constraints"], state["held"], state["agenda"]
        is_constraint = constraints != NONE
        is_open = (agenda | state["pending"]) & ~is_constraint
        is_open[..., self._ticket] = False
        is_unsaid = (agenda & is_constraint).any(-1)
        has_offered = state["constraints_met"] | (state["agent_informs"][..., self._complete] > 0)

        all_at_once = is_open & agenda & may_request & is_unsaid[..., None]
        wrong = is_constraint & (held != constraints) & may_request
        stray = ~is_constraint & ~state["requests"] & self._constrains & may_request
        stray = stray & (held > DONT_CARE)
        answers = is_open & may_inform
        asks = all_at_once.any(-1) | wrong.any(-1) | is_unsaid | stray.any(-1)
        order = self._records_left(held, is_open, answers & ~asks[..., None])

        action = torch.where(has_offered, self._end, self._offer)
        action = torch.where(answers.any(-1), self._inform[order.argmax(-1)], action)
        action = torch.where(stray.any(-1), self._first(stray), action)
        action = torch.where(is_unsaid, self._continue, action)
        action = torch.where(wrong.any(-1), self._first(wrong), action)
        action = torch.where(all_at_once.any(-1), self._first(all_at_once), action)
        return tensordict.set("action", action)

    def _first(self, slots: torch.Tensor) -> torch.Tensor:
        """Returns the request of the first flagged slot, long ``[*B]``; without a flag any."""
        return self._request[slots.to(torch.uint8).argmax(-1)]

    def _records_left(
        self, held: torch.Tensor, is_open: torch.Tensor, answers: torch.Tensor
    ) -> torch.Tensor:
        """Counts the records left after each possible answer.

        Args:
            held: long ``[*B, S]``, the values that the tracker holds.
            is_open: bool ``[*B, S]``, the open questions.
            answers: bool ``[*B, S]``, the answers to evaluate.

        Returns:
            Long ``[*B, S]``: the number of records that match the values held after the answer and
            have values for all other open questions; -1 for answers that are not evaluated.
        """
        shape, n_slots = held.shape, held.shape[-1]
        held, is_open, answers = (part.reshape(-1, n_slots) for part in (held, is_open, answers))
        left = torch.full_like(held, -1)
        row, slot = answers.nonzero(as_tuple=True)
        if slot.numel() == 0:
            return left.view(shape)
        held, others = held[row], is_open[row]
        counts, _ = self._knowledge_base.counts_by_value(held, slot)
        value = self._knowledge_base.most_frequent(counts, slot)
        held = held.scatter(-1, slot[:, None], value[:, None])
        others = others.scatter(-1, slot[:, None], False)
        records = self._knowledge_base.matching(held)
        for is_other, with_slot in zip(others.unbind(-1), self._records_with, strict=True):
            records = torch.where(is_other[:, None], records & with_slot, records)
        left[row, slot] = popcount(records)
        return left.view(shape)


def _actions_of_slots(names: tuple[str, ...], act: str, slots: tuple[str, ...]) -> torch.Tensor:
    """Returns the action of each slot, long ``[S]``, or -1."""
    index = {name: number for number, name in enumerate(names)}
    return torch.tensor([index.get(f"{act}({slot})", -1) for slot in slots])


def _legal(is_legal: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
    """Returns the slots with a legal action, bool ``[*B, S]``."""
    return is_legal[..., actions.clamp(min=0)] & (actions >= 0)


class SequencePolicy(TensorDictModuleBase):
    """Plays a fixed sequence of actions by the entry ``turns``, then repeats the last one.

    Args:
        actions: the actions in order, at least one.

    Raises:
        TypeError: if an action is not an integer.

    Examples:
        >>> from tensordict import TensorDict
        >>> policy = SequencePolicy([4, 2, 7])
        >>> policy(TensorDict(turns=torch.tensor([[0], [1], [9]]), batch_size=[3]))["action"]
        tensor([4, 2, 7])
    """

    actions: torch.Tensor

    def __init__(self, actions: Sequence[int]) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["turns"], ["action"]
        self.register_buffer("actions", torch.tensor([index(action) for action in actions]))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action of this turn."""
        turns = tensordict.get("turns").squeeze(-1)
        return tensordict.set("action", self.actions[turns.clamp(max=len(self.actions) - 1)])


class CarefulPolicy(TensorDictModuleBase):
    """Requests unfilled slots, answers requests, offers a booking and ends.

    It uses only flags of the observation. It makes its requests in order, without those of filled
    slots. Then it answers the first open question of each turn until all are answered, offers the
    booking, and ends. It skips illegal requests and answers.

    Args:
        env: a :class:`~bbq_torchrl.envs.DialogueEnv` with the domain's actions; transforms must not
            change the observation.
        slots: the slots that it requests, in order.

    Raises:
        ValueError: if the domain lacks an action that the policy needs.
    """

    def __init__(self, env: EnvBase, slots: Sequence[str]) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["observation", "action_mask"], ["action"]
        domain, layout = env.domain, env.layout
        answers = [
            slot
            for slot in domain.slots
            if slot not in domain.special_slots and f"inform({slot})" in domain.action_names
        ]
        offer = f"inform({domain.complete_slot})"
        plan = [*(f"request({slot})" for slot in slots), *(f"inform({slot})" for slot in answers)]
        self._plan = indices(domain.action_index(name) for name in (*plan, offer))
        self._requested = indices(layout.column("agent_requested", slot) for slot in slots)
        self._filled = indices(layout.column("filled", slot) for slot in slots)
        self._asked = indices(layout.column("user_requested", slot) for slot in answers)
        self._answered = layout.column("agent_act", "inform")
        self._offered = layout.column("agent_informed", domain.complete_slot)
        self._end = domain.action_index("thanks")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the next action."""
        flags, is_legal = tensordict.get("observation") > 0, tensordict.get("action_mask")
        positions = torch.arange(len(self._filled), device=flags.device)
        position = torch.where(flags[..., self._requested], positions, -1).amax(-1, keepdim=True)
        has_answered = flags[..., self._answered, None]
        may_request = ~flags[..., self._filled] & (positions > position) & ~has_answered
        may_offer = torch.ones_like(has_answered)
        is_open = torch.cat([may_request, flags[..., self._asked], may_offer], -1)
        is_open = is_open & is_legal[..., self._plan]
        action = self._plan[is_open.to(torch.uint8).argmax(-1)]
        action = torch.where(flags[..., self._offered], self._end, action)
        return tensordict.set("action", action)


class UniformPolicy(TensorDictModuleBase):
    """Plays uniformly random legal actions. Unlike TorchRL's ``RandomPolicy`` it reads the mask.

    Examples:
        >>> from tensordict import TensorDict
        >>> mask = torch.tensor([[False, True, False]])
        >>> UniformPolicy()(TensorDict(action_mask=mask, batch_size=[1]))["action"]
        tensor([1])
    """

    def __init__(self) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["action_mask"], ["action"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action."""
        mask = tensordict.get("action_mask")
        uniform = torch.rand(mask.shape, device=mask.device)
        return tensordict.set("action", torch.where(mask, uniform, -1.0).argmax(-1))


MEMORY = "memory"
"""The entry with the policy's memory."""

MAX_CONFIRMS = 12
"""The limit on asking the user to continue."""

MAX_OFFERS = 3
"""The limit on offers of a booking."""


class RepairPolicy(TensorDictModuleBase):
    """Books from observations alone, and asks again after a misunderstanding.

    Each turn it takes the first action with a reason:

    1. The user has just thanked for the booking: end the dialogue.
    2. The user asks a question in the first turn: request the question's slot, which makes a
       simulated user inform all its constraints at once.
    3. No record matches the values held before any answer, or an offer was denied: request the
       filled slots again, in order; after a denial all of them once, otherwise until a record
       matches.
    4. The user asks a question: answer it.
    5. The user may have more to say: inform the ticket once, then ``confirm_answer`` until the user
       gives thanks, at most :data:`MAX_CONFIRMS` times.
    6. Offer the booking, at most :data:`MAX_OFFERS` times.
    7. End the dialogue.

    Its memory of requests, informs and offers is a nested TensorDict, the entry :data:`MEMORY`. It
    is a function of the observations so far, empty at the start of a dialogue. Rollouts and
    collectors pass it from turn to turn; other loops do so by ``step_mdp``.

    Args:
        env: a :class:`~bbq_torchrl.envs.DialogueEnv` with the domain's actions; transforms must not
            change the observation.
        slots: the slots that it requests again, in order.

    Raises:
        ValueError: if the domain lacks an action that the policy needs.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> from bbq_torchrl.envs import DialogueEnv
        >>> env = DialogueEnv(movie_domain(), batch_size=(3,), seed=0)
        >>> rollout = env.rollout(4, RepairPolicy(env, ["moviename", "city", "date"]))
        >>> rollout["memory", "asked"].shape
        torch.Size([3, 4, 29])
    """

    def __init__(self, env: EnvBase, slots: Sequence[str]) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["observation", "action_mask"], ["action", MEMORY]
        domain, self._layout = env.domain, env.layout
        names, ordinary = domain.action_names, set(domain.slots) - set(domain.special_slots)
        askable, answers = (
            [slot for slot in domain.slots if slot in ordinary and f"{act}({slot})" in names]
            for act in ("request", "inform")
        )
        plan = [
            *(f"request({slot})" for slot in (*askable, *slots)),
            *(f"inform({slot})" for slot in answers),
            f"inform({domain.ticket_slot})",
            "confirm_answer",
            f"inform({domain.complete_slot})",
            "thanks",
        ]
        self._plan = indices(domain.action_index(name) for name in plan)
        self._askable, self._slots, self._answers = (
            indices(domain.slots.index(slot) for slot in some) for some in (askable, slots, answers)
        )
        self._n_slots = len(domain.slots)
        self._ticket = domain.slots.index(domain.ticket_slot)
        self._complete = domain.slots.index(domain.complete_slot)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the next action and the memory."""
        flags, is_legal = tensordict.get("observation") > 0, tensordict.get("action_mask")
        layout, column = self._layout, self._layout.column
        is_first = ~flags[..., layout["agent_act"]].any(-1, keepdim=True)
        is_thanked = flags[..., column("user_act", "thanks"), None]
        nothing_matches = ~flags[..., column("kb_match", "all"), None]
        told = flags[..., layout["agent_informed"]]
        has_offered = told[..., self._complete, None]
        filled, questions = flags[..., layout["filled"]], flags[..., layout["user_requested"]]

        memory = self._remembered(tensordict, is_first)
        asked = memory["asked"] | flags[..., layout["agent_requested"]]
        told = memory["told"] | told & ~has_offered
        offers = memory["offers"] + has_offered
        confirms = memory["confirms"] + flags[..., column("agent_act", "confirm_answer"), None]
        confirms = torch.where(is_thanked, MAX_CONFIRMS, confirms)

        has_answered = told[..., self._answers].any(-1, keepdim=True)
        is_misheard = nothing_matches & ~has_answered
        again = (filled & ~told)[..., self._slots]
        left = again & ~asked[..., self._slots]
        begins = has_offered | (is_misheard & ~left.any(-1, keepdim=True))
        asked, left = asked & ~begins, torch.where(begins, again, left)

        may_confirm = confirms < MAX_CONFIRMS
        reasons = [
            questions[..., self._askable] & is_first,
            left & (is_misheard | (offers > 0)),
            questions[..., self._answers],
            may_confirm & ~filled[..., self._ticket, None],
            may_confirm,
            offers < MAX_OFFERS,
        ]
        ends = torch.ones_like(is_first)
        is_open = torch.cat([torch.cat(reasons, -1) & ~(has_offered & is_thanked), ends], -1)
        is_open = is_open & is_legal[..., self._plan]
        remembered = {"asked": asked, "told": told, "confirms": confirms, "offers": offers}
        tensordict.set(MEMORY, TensorDict(remembered, batch_size=tensordict.batch_size))
        return tensordict.set("action", self._plan[is_open.to(torch.uint8).argmax(-1)])

    def _remembered(self, tensordict: TensorDictBase, is_first: torch.Tensor) -> TensorDictBase:
        """Returns the memory of earlier turns, empty at the start of a dialogue.

        Raises:
            ValueError: if a dialogue in progress lacks it.
        """
        memory = tensordict.get(MEMORY, None)
        if memory is not None:
            return memory.apply(lambda entry: entry * ~is_first)
        if not bool(is_first.all()):
            raise ValueError(
                f"the entry {MEMORY!r} is missing in a dialogue in progress: pass it from step to "
                "step, as step_mdp(env.step(tensordict)) does"
            )
        nothing = torch.zeros_like(is_first, dtype=torch.int64)
        no_slot = torch.zeros_like(is_first).repeat_interleave(self._n_slots, -1)
        empty = {"asked": no_slot, "told": no_slot, "confirms": nothing, "offers": nothing}
        return TensorDict(empty, batch_size=tensordict.batch_size)


def indices(numbers: Iterable[int]) -> torch.nn.Buffer:
    """Returns indices as an int64 buffer, which moves with its module."""
    return torch.nn.Buffer(torch.tensor(list(numbers), dtype=torch.int64))


def scripted_policy(name: str, env: EnvBase) -> TensorDictModuleBase:
    """Returns a policy by name, on the environment's device.

    Args:
        name: one of the domain's policies (the movie domain has ``rule``, ``rule_inform``,
            ``careful_essential``, ``careful`` and ``repair``), ``"random"``, or the privileged
            ``"clairvoyant"``.
        env: a :class:`~bbq_torchrl.envs.DialogueEnv`; transforms must not change the observation
            and the mask.

    Raises:
        ValueError: if the policy does not exist, or a step of its script is illegal in the
            environment's round.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> from bbq_torchrl.envs import DialogueEnv
        >>> env = DialogueEnv(movie_domain(), batch_size=(3,), seed=0)
        >>> rollout = env.rollout(2, scripted_policy("rule", env))
        >>> [env.domain.action_names[action] for action in rollout["action"][0]]
        ['request(moviename)', 'request(starttime)']
    """
    domain: Domain = env.domain
    if name == RANDOM_POLICY:
        return UniformPolicy()
    if name == PRIVILEGED_POLICY:
        return ClairvoyantPolicy(env)
    if name not in domain.policies:
        names = (RANDOM_POLICY, *domain.policies, PRIVILEGED_POLICY)
        raise ValueError(f"policy must be one of {', '.join(names)}, got {name!r}")
    specification = domain.policies[name]
    policy: TensorDictModuleBase
    if specification.kind == "script":
        steps = [domain.action_index(step) for step in specification.steps]
        is_legal = env.simulator.action_mask(env.active_slots)
        for step in steps:
            if not is_legal[step]:
                action = domain.actions[step]
                raise ValueError(
                    f"policy {name} cannot be played in round {env.round}: the slot "
                    f"{action.slot} of its step {action} is added later"
                )
        policy = SequencePolicy(steps)
    elif specification.kind == "careful":
        policy = CarefulPolicy(env, specification.steps)
    else:
        policy = RepairPolicy(env, specification.steps)
    return policy.to(env.device)
