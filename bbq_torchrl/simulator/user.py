"""The agenda-based user: its first turn, and its replies to the agent's acts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains.values import DONT_CARE, NO_MATCH, NONE
from bbq_torchrl.simulator.choices import index_below, pick_slot, rows

if TYPE_CHECKING:
    from tensordict import TensorDictBase

    from bbq_torchrl.domains import DomainTensors
    from bbq_torchrl.simulator.tracker import AgentTurn


class User:
    """The agenda-based user of Li et al. (2016), for a batch of dialogues.

    It stores only the domain's tables; the users themselves are in the state. It returns entries of
    the state of :class:`~bbq_torchrl.simulator.Simulator`, which documents them.

    Args:
        domain: the domain's tensors.
    """

    def __init__(self, domain: DomainTensors) -> None:
        self._domain = domain
        self._act = domain.act
        slots = torch.arange(domain.n_slots, device=domain.records.device)
        self._is_ticket = slots == domain.ticket

    def first_turn(self, draws: TensorDictBase, active: torch.Tensor) -> dict[str, torch.Tensor]:
        """Draws users and their first turn. Returns entries of the state.

        The first turn is a request that also informs the opening slots.

        Args:
            draws: uniform ``goal`` ``[*B]``, ``constraint`` and ``request`` ``[*B, S]``.
            active: bool ``[S]``; goals are restricted to these slots and the ticket.
        """
        domain = self._domain
        goal = index_below(draws["goal"], domain.goal_constraints.shape[0])
        constraints = rows(domain.goal_constraints, goal) * active
        requests = (rows(domain.goal_requests, goal) & active) | self._is_ticket
        is_constraint = constraints != NONE
        is_said = (domain.opening & is_constraint) | pick_slot(is_constraint, draws["constraint"])
        other_requests = requests & ~self._is_ticket
        has_other = other_requests.any(-1, keepdim=True)
        return {
            "goal_id": goal,
            "constraints": constraints,
            "requests": requests,
            "agenda": (is_constraint & ~is_said) | requests,
            "pending": pick_slot(other_requests, draws["request"]) | (self._is_ticket & ~has_other),
            "user_act": torch.full_like(goal, self._act["request"]),
            "meant_informs": constraints * is_said,
        }

    def reply(
        self,
        state: TensorDictBase,
        agent: AgentTurn,
        is_over: torch.Tensor,
        draws: TensorDictBase,
    ) -> dict[str, torch.Tensor]:
        """Returns the users' reply to the agent's act, as the changed entries of the state.

        Args:
            state: the state before the agent's act.
            agent: the agent's act, completed by the tracker.
            is_over: bool ``[*B]``, dialogues in which the user no longer listens.
            draws: uniform ``agenda`` ``[*B, S]`` and ``offer`` ``[*B]``.
        """
        constraints, agenda, pending = state["constraints"], state["agenda"], state["pending"]
        is_constraint = constraints != NONE
        is_slot, listens = agent.is_slot, ~is_over

        def of_slot(values: torch.Tensor) -> torch.Tensor:
            return values.gather(-1, agent.slot[..., None]).squeeze(-1)

        def at_slot(is_so: torch.Tensor) -> torch.Tensor:
            return is_slot & is_so[..., None]

        # The transmitted values, errors included, enter the history now.
        transmitted = state["user_informs"]
        enters = (transmitted != NONE) & listens[..., None]
        history = torch.where(enters, transmitted, state["history"])

        # The agent's act, and the role of its slot in this user's goal.
        asks = agent.is_request & listens
        tells = agent.is_inform & listens
        books = agent.is_booking & listens
        confirms = agent.is_confirm_answer & listens
        wanted, heard_before = of_slot(constraints), of_slot(history)
        is_wanted = wanted != NONE
        is_open = of_slot(state["requests"]) & ~is_wanted
        is_on_agenda = of_slot(agenda)

        repeats_wish = asks & is_wanted
        passes_on = asks & is_open & ~is_on_agenda & (heard_before != NONE)
        asks_back = asks & is_open & is_on_agenda
        has_no_view = asks & ~(repeats_wish | passes_on | asks_back)
        is_right = agent.value == wanted
        corrects = tells & is_wanted & ~is_right
        learns = tells & ~is_wanted
        says_slot = repeats_wish | passes_on | has_no_view | corrects
        said = torch.where(is_wanted, wanted, torch.where(passes_on, heard_before, DONT_CARE))
        leaves = repeats_wish | tells
        if agent.offered is not None:
            chooses = agent.is_multiple_choice & listens
            said = torch.where(chooses & ~is_wanted, agent.choose(draws["offer"]), said)
            says_slot, leaves = says_slot | chooses, leaves | (chooses & is_wanted)
        is_idle = ~(pending | agenda).any(-1)

        # The verdict on a booking.
        is_met = (~is_constraint | (state["held"] == constraints)).all(-1)
        constraints_met = torch.where(books, is_met, state["constraints_met"])
        is_refused = self._is_ticket & (books & (agent.value == NO_MATCH))[..., None]

        history = torch.where(at_slot(tells), agent.value[..., None], history)
        history = torch.where(is_refused, NO_MATCH, history)
        clears = repeats_wish | passes_on | (books & ~is_met)
        pending = pending & ~(clears[..., None] | at_slot(learns) | is_refused)
        pending = pending | at_slot(asks_back)
        agenda = agenda & ~(at_slot(leaves) | is_refused)

        # The user continues with a pending request, else with the agenda, else with the ticket.
        continues = tells & ~corrects
        moves_on = continues & ~pending.any(-1)
        from_any = agenda & confirms[..., None]
        pool = from_any | (agenda & ~self._is_ticket & moves_on[..., None])
        picked = pick_slot(pool, draws["agenda"])
        has_pool = pool.any(-1)
        picks_wish = (picked & is_constraint).any(-1)
        asks_ticket = (
            moves_on & agenda[..., self._domain.ticket] & (~has_pool | learns & picks_wish)
        )
        pending = pending | (picked & ~is_constraint) | (self._is_ticket & asks_ticket[..., None])
        is_said = is_constraint & (picked | (agenda & asks_back[..., None]))
        agenda = agenda & ~is_said

        informs = torch.where(at_slot(says_slot), said[..., None], constraints * is_said)

        ids = self._act
        act = torch.where(says_slot, ids["inform"], state["user_act"])
        act = torch.where(has_no_view & is_idle, ids["thanks"], act)
        is_asking = asks_back | (continues & pending.any(-1)) | (confirms & has_pool & ~picks_wish)
        is_thanking = (books & is_met) | ((continues | confirms) & ~has_pool)
        act = torch.where(is_thanking, ids["thanks"], act)
        act = torch.where((continues | confirms) & picks_wish, ids["inform"], act)
        act = torch.where(is_asking, ids["request"], act)
        act = torch.where(books & ~is_met, ids["deny"], act)
        act = torch.where(agent.is_end | is_over, ids["closing"], act)
        return {
            "agenda": agenda,
            "pending": pending,
            "history": history,
            "constraints_met": constraints_met,
            "user_act": act,
            "meant_informs": informs,
        }
