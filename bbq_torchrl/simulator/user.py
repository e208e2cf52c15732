"""The agenda-based users: the paper's, and users that differ by the traits of a mix."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bbq_torchrl.domains import DomainTensors
from bbq_torchrl.domains.tensors import Movable, index_below, pick_slot, rows
from bbq_torchrl.domains.values import DONT_CARE, NO_MATCH, NONE
from bbq_torchrl.simulator.profiles import Mix
from bbq_torchrl.simulator.tracker import AgentTurn


class User(Movable):
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

    def first_turn(self, draws: TensorDictBase, active: Tensor) -> dict[str, Tensor]:
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
        self, state: TensorDictBase, agent: AgentTurn, is_over: Tensor, draws: TensorDictBase
    ) -> dict[str, Tensor]:
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

        def of_slot(values: Tensor) -> Tensor:
            return values.gather(-1, agent.slot[..., None]).squeeze(-1)

        def at_slot(is_so: Tensor) -> Tensor:
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


class MixedUser(User):
    """Users with traits, for a batch of dialogues.

    Their replies are those of :class:`~bbq_torchrl.simulator.user.User`, changed by the traits in
    the state's entry ``traits`` (:meth:`~bbq_torchrl.simulator.profiles.Mix.traits`).

    Args:
        domain: the domain's tensors.
        mix: the profiles' tables.
    """

    def __init__(self, domain: DomainTensors, mix: Mix) -> None:
        super().__init__(domain)
        self._mix = mix

    def first_turn(
        self, draws: TensorDictBase, active: Tensor
    ) -> dict[str, Tensor | TensorDictBase]:
        """Draws users, their traits and their first turn; see :meth:`User.first_turn`."""
        first = super().first_turn(draws, active)
        traits = self._mix.traits(draws, first["goal_id"], active)
        is_late, informs = traits["asks_late"][..., None], first["meant_informs"]
        told, opening = (first["constraints"], informs, first["agenda"]), self._domain.opening
        return {
            **first,
            "traits": traits,
            "pending": torch.where(is_late, self._is_ticket, first["pending"]),
            **self._tell(traits, *told, opening, (informs != NONE).any(-1)),
        }

    def reply(
        self, state: TensorDictBase, agent: AgentTurn, is_over: Tensor, draws: TensorDictBase
    ) -> dict[str, Tensor | TensorDictBase]:
        """Returns the users' reply; see :meth:`User.reply`."""
        traits, acts = state["traits"], self._act
        listens = ~(is_over | agent.is_end)

        def column(flags: Tensor) -> Tensor:
            return (flags & listens)[..., None]

        # A change of mind comes first: the reply is to the new goal.
        is_known = (traits["other"] != NONE) & ~state["agenda"]
        is_time = column(state["turn"] >= traits["changes_at"])
        changed = pick_slot(is_known & is_time, traits["order"])
        is_changed = changed.any(-1)
        constraints = torch.where(changed, traits["other"], state["constraints"])
        is_constraint = constraints != NONE
        was_met = state["constraints_met"] & ~is_changed

        # A question for later is not on the agenda yet, unless the agent asks about its slot.
        is_question = state["requests"] & ~self._is_ticket
        waits = column(traits["asks_late"] & ~was_met & ~agent.is_request)
        later = waits & state["agenda"] & is_question & ~state["pending"]
        now = {"constraints": constraints, "constraints_met": was_met}
        before = state.replace(**now, agenda=state["agenda"] & ~later)
        reply = super().reply(before, agent, is_over, draws)
        act, informs, is_met = reply["user_act"], reply["meant_informs"], reply["constraints_met"]
        agenda = reply["agenda"] | (later & ~(agent.is_slot & agent.is_inform[..., None]))

        # A question ignored once too often: the user leaves before the agent's next turn.
        waiting = state["pending"] & is_question
        is_answer = (waiting & agent.is_slot).any(-1) & agent.is_inform
        is_ignored = waiting.any(-1) & listens & ~(is_answer | agent.is_request)
        bears = traits["bears"] - is_ignored.long()

        # Corrections of a value told, and of an offer.
        told = agent.is_slot & is_constraint & agent.is_inform[..., None]
        is_right = agent.value[..., None] == constraints
        denied = told & ~is_right & column(traits["withholds"])
        act = torch.where(denied.any(-1), acts["deny"], act)
        informs, agenda = torch.where(denied, NONE, informs), agenda | denied
        missed = is_constraint & (state["held"] != constraints)
        missed = missed & column(traits["explains"] & agent.is_booking & ~is_met)
        explained = missed | changed
        informs, agenda = torch.where(explained, constraints, informs), agenda & ~explained
        act = torch.where(is_changed & (act == acts["thanks"]), acts["inform"], act)

        # One question at a time, until it is answered; some come after the offer.
        insists, pending = column(traits["insists"]), reply["pending"]
        asked = waiting & agenda
        again = insists & asked.any(-1, keepdim=True)
        pending = torch.where(again, asked, pending)
        has_question = (pending & is_question).any(-1, keepdim=True)
        pending = pending & ~(insists & has_question & self._is_ticket)
        is_late = column(traits["asks_late"] & is_met)
        late = pick_slot(agenda & is_question & is_late, traits["order"])
        asks_late = late.any(-1, keepdim=True) & agent.is_booking[..., None] & ~again
        pending = torch.where(asks_late, late, pending)
        is_mild = (act == acts["inform"]) | (act == acts["thanks"])
        act = torch.where((again | asks_late).squeeze(-1) & is_mild, acts["request"], act)
        is_settled = ~((agenda | pending) & ~self._is_ticket).any(-1) & is_late.squeeze(-1)
        act = torch.where(is_settled & (act == acts["request"]), acts["thanks"], act)

        # Yes to what it has told before.
        checked = agent.is_slot & is_constraint & ~state["agenda"] & agent.is_request[..., None]
        is_known = ((told & is_right) | checked) & column(traits["confirms"] & ~is_changed)
        is_mild = (act == acts["inform"]) | (act == acts["thanks"])
        act = torch.where(is_known.any(-1) & is_mild, acts["confirm_answer"], act)
        tells = (informs != NONE).any(-1)
        other = torch.where(is_changed[..., None], NONE, traits["other"])
        return {
            **reply,
            "constraints": constraints,
            "traits": traits.replace(
                other=other, bears=bears, limit=torch.where(bears > 0, traits["limit"], 0)
            ),
            "pending": pending,
            "user_act": act,
            **self._tell(traits, constraints, informs, agenda, agent.is_slot | changed, tells),
        }

    @staticmethod
    def _tell(
        traits: TensorDictBase,
        constraints: Tensor,
        informs: Tensor,
        agenda: Tensor,
        is_first: Tensor,
        tells: Tensor,
    ) -> dict[str, Tensor]:
        """Tells as many constraints as users with these traits do. Returns entries of the state.

        Args:
            traits: the users' traits.
            constraints: long ``[*B, S]``.
            informs: long ``[*B, S]``, the values that the agenda-based user would tell.
            agenda: bool ``[*B, S]``, the agenda after that.
            is_first: bool ``[*B, S]``, the slots that it tells before others.
            tells: bool ``[*B]``, whether it tells any value in this turn.
        """
        is_constraint, most = constraints != NONE, traits["tells"][..., None]
        said = is_constraint & (informs == constraints)
        n_slots = said.shape[-1]
        rank = traits["order"] + n_slots * (said & is_first)
        rank = torch.where(said | (agenda & is_constraint), rank, -1)
        highest = rank.sort(-1, descending=True).values
        least = highest.gather(-1, (most - 1).clamp(0, n_slots - 1))
        kept = torch.where(tells[..., None] & (most > 0), (rank >= 0) & (rank >= least), said)
        return {
            "agenda": (agenda | said) & ~kept,
            "meant_informs": torch.where(kept, constraints, torch.where(said, NONE, informs)),
        }
