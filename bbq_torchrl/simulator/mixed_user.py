"""Users that differ: the agenda-based user with the traits of a mix."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains.values import NONE
from bbq_torchrl.simulator.choices import pick_slot
from bbq_torchrl.simulator.user import User

if TYPE_CHECKING:
    from tensordict import TensorDictBase

    from bbq_torchrl.domains import DomainTensors
    from bbq_torchrl.simulator.profiles import Mix
    from bbq_torchrl.simulator.tracker import AgentTurn


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
        self, draws: TensorDictBase, active: torch.Tensor
    ) -> dict[str, torch.Tensor | TensorDictBase]:
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
        self,
        state: TensorDictBase,
        agent: AgentTurn,
        is_over: torch.Tensor,
        draws: TensorDictBase,
    ) -> dict[str, torch.Tensor | TensorDictBase]:
        """Returns the users' reply; see :meth:`User.reply`."""
        traits, acts = state["traits"], self._act
        listens = ~(is_over | agent.is_end)

        def column(flags: torch.Tensor) -> torch.Tensor:
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

        # A question passed over once too often: the user leaves before the agent's next turn.
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
        constraints: torch.Tensor,
        informs: torch.Tensor,
        agenda: torch.Tensor,
        is_first: torch.Tensor,
        tells: torch.Tensor,
    ) -> dict[str, torch.Tensor]:
        """Tells as many constraints as the users do in a turn. Returns entries of the state.

        Args:
            traits: of the users.
            constraints: long ``[*B, S]``.
            informs: long ``[*B, S]``, what the agenda-based user would tell.
            agenda: bool ``[*B, S]``, after that.
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
