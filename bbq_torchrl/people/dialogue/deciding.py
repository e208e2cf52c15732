"""The agent's decision on an act: its reply, the list of what is asked for, or the way out."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.frames import ANY, NO_MATCH_TEXT
from bbq_torchrl.domains.values import fold
from bbq_torchrl.people.dialogue.exchange import Answer, Memory, led, say, values_of
from bbq_torchrl.people.dialogue.proposals import MAX_NAMED
from bbq_torchrl.people.dialogue.tracking import full
from bbq_torchrl.people.language import Frame

if TYPE_CHECKING:
    from collections.abc import Sequence, Set

    from tensordict import TensorDict

    from bbq_torchrl.people.dialogue.control import Control
    from bbq_torchrl.people.dialogue.hearing import Hearing
    from bbq_torchrl.people.dialogue.proposals import Proposals
    from bbq_torchrl.people.dialogue.tracking import Acting
    from bbq_torchrl.people.dialogue.ways_out import WaysOut
    from bbq_torchrl.people.language import Understood

_MAX_DENIED = 4
"""The number of refused offers after which the agent ends the conversation."""


class Deciding:
    """The answers of a policy to a person's acts, under the rules of the dialogue control.

    Args:
        hear: the reading of texts.
        control: the rules.
        acting: the agent's acts.
        proposals: the proposals of records.
        ways_out: what is said where there are several, or where no record has all wishes.
        details: the slots that few goals constrain.
        max_turn: the number of turns after which a conversation ends.
    """

    def __init__(
        self,
        hear: Hearing,
        control: Control,
        acting: Acting,
        proposals: Proposals,
        ways_out: WaysOut,
        details: Set[str],
        max_turn: int,
    ) -> None:
        self._hear, self._control, self._acting = hear, control, acting
        self._proposals, self._ways_out = proposals, ways_out
        self._details, self._max_turn = details, max_turn
        self._spelling, self._nlg = proposals.spelling, proposals.nlg
        self._tracking, domain = proposals.tracking, proposals.spelling.domain
        self._ticket = domain.ticket_slot
        self._fixed = {*domain.essential} - {*domain.free_slots}

    def __call__(
        self,
        now: Memory,
        reading: Understood,
        understood: Frame,
        words: dict[str, Any],
        question: Frame | None = None,
        *,
        is_booked: bool = False,
        lists: Sequence[str] = (),
    ) -> Answer:
        """Returns the policy's answer to an act, or the way out if no record has all wishes.

        Of the slots in ``lists`` it is the list of what is left, if there are several, or the list
        that ``question`` is, with what is asked of its values.
        """
        before, rules, is_offered = now.state, self._control.rules, now.is_offered
        is_denied = is_offered and self._hear.is_bare(understood, "deny")
        told = {**understood.informs}
        held = self._tracking.kept(before)
        if not told.items() <= held.items():
            now = replace(now, times=0)
        here = self._proposals.implied(told).items()
        named = tuple(one for one in now.refused if here.isdisjoint(one.items()))
        now = replace(now, refused=named)
        if is_denied:
            now = replace(self._proposals.refuse(now), denied=now.denied + 1)
            if now.denied >= _MAX_DENIED:
                sentence, answered = self._nlg.say("no_more", **words), Frame("closing")
                return Answer(sentence, reading, understood, answered, now, ended="agent")
        asked = [slot for slot in understood.requests if slot != self._ticket]
        state = None
        if "way_out" in rules:
            understood, state = self._heard(before, understood)
            if not is_denied and self._control.is_stuck(state, self._proposals.refused(now)):
                now = replace(now, state=state)
                return self._proposals.alternative(now, reading, words, asked, is_refused=False)
            news = values_of(understood).items()
            is_left = any(now.proposal.get(slot, value) != value for slot, value in news)
            if not (is_denied or (now.proposal and not is_left) or bool(state["offered"])):
                now_told = replace(now, state=state)
                listed = self._ways_out.beside(now_told, reading, question, words)
                listed = listed or self._ways_out.listed(now_told, reading, words, lists)
                if listed is not None:
                    return replace(listed, understood=understood)
        reply = self._acting.book if is_booked else self._acting.reply
        acted = reply(before, understood, words["session"], self._proposals.refused(now))
        if state is not None and self._is_elsewhere(state, acted.state):
            # A record that lacks a wish lent its values to another place.
            now = replace(now, state=state)
            found = self._proposals.alternative(now, reading, words, asked, is_refused=False)
            return replace(found, understood=understood)
        is_asked = acted.answered.act == "request"
        is_asked &= not (self._fixed.isdisjoint(acted.answered.requests) or now.proposal)
        answers = [item for act, _ in acted.parts for item in act.informs.items()]
        lacks = {slot for slot, value in answers if value == NO_MATCH_TEXT}
        sentences = [self._nlg.agent(act, kept, **words) for act, kept in acted.parts]
        if state is not None and is_asked and not (is_denied or lacks & self._fixed):
            now_told, slot = replace(now, state=state), acted.answered.requests[0]
            earlier = [] if asked and not lacks else sentences[:-1]
            unasked = self._ways_out.unasked(
                now_told, reading, words, slot, [*asked, *dict(answers)]
            )
            if unasked is not None:
                return led(replace(unasked, understood=understood), " ".join(earlier))
        if state is not None:
            told = {s: v for act, _ in acted.parts for s, v in act.informs.items() if s in asked}
            other = self._ways_out.on_file(replace(now, state=state), reading, words, told)
            if other is not None:
                return led(replace(other, understood=understood), sentences[0])
        answered, now = acted.answered, replace(now, state=acted.state, proposal={}, times=0)
        if is_denied and bool(acted.state["offered"]):
            names = list(values_of(self._tracking.kept(acted.state)))[:MAX_NAMED]
            return say(now, self._nlg.say("change", names, **words), reading)
        ended = "agent" if answered.act in ("thanks", "closing") else ""
        if ended and (is_booked or (is_offered and acted.understood.act == "thanks")):
            booked = self._tracking.values(acted.state["held"])
            sentences[:-1] = [self._nlg.say("booked", values=booked, **words)]
        if not ended and 2 * now.texts >= self._max_turn:
            ended = "turns"
        sentence, left_out = " ".join(sentences), acted.control
        return Answer(sentence, reading, acted.understood, answered, now, True, ended, left_out)

    def _is_elsewhere(self, before: TensorDict, after: TensorDict) -> bool:
        """Returns whether an act tells a place that is in none that was told before it."""
        wishes, told = (values_of(self._tracking.kept(state)) for state in (before, after))
        news = {slot: value for slot, value in told.items() if slot not in wishes}
        implied = self._proposals.implied(news)
        placed = wishes.keys() - self._details
        return any(implied.get(slot, wishes[slot]) != wishes[slot] for slot in placed)

    def told(self, before: TensorDict | None, act: Frame) -> tuple[Frame, TensorDict]:
        """Returns an act with what it takes back unsaid, and the state after it."""
        held = self._tracking.kept(before)
        told = {slot: v for slot, v in values_of(act).items() if slot in self._details}
        if told and (here := self._proposals.lasting(told)):  # a zip code is in a city
            rest = {**held, **act.informs}
            known = self._proposals.lasting({s: v for s, v in rest.items() if s not in told})
            near = {s: v for s, v in here.items() if s in self._fixed and s not in known}
            act = replace(act, informs={**near, **act.informs})
        implied = self._proposals.implied(values_of(act))
        # A theater of another chain takes back the chain.
        gone = {
            slot: ANY
            for slot, value in held.items()
            if slot in self._details and slot not in values_of(act)
            if value != ANY and implied.get(slot, value) != value
        }
        gone |= {  # though no record has the chain of that theater
            slot: ANY
            for slot, whole in self._spelling.wholes.items()
            if whole in act.informs and held.get(slot, ANY) != ANY and slot not in act.informs
            if not act.informs[whole].startswith(f"{held[slot]} ")
        }
        act = replace(act, informs={**gone, **act.informs})
        state = self._acting.hear(before, act)
        if self._control.is_stuck(state):
            for others in self._proposals.otherwise(state, act):
                freed = replace(act, informs={**act.informs, **others})
                found = self._acting.hear(before, freed)
                if others and not self._control.is_stuck(found):
                    return freed, found
        return act, state

    def _heard(self, before: TensorDict | None, understood: Frame) -> tuple[Frame, TensorDict]:
        """Returns an act and the state after it.

        A value that no record has with the others is that of another slot, if a record has all of
        them then: "tonight" is a date, or a time. A part of the day is else a time in it, and
        a day a part of it.
        """
        lexicon, informs = self._spelling.lexicon, values_of(understood)
        understood, state = self.told(before, understood)
        distance = self._control.records.best(full(state))[2]
        for (slot, value), other in product(informs.items(), lexicon.slots if distance else ()):
            # Exactly the same name: "7 pm" is not seven people.
            link = lexicon.link(other, value)
            if other not in informs and link.is_exact and fold(link.values[0]) == fold(value):
                rest = {name: told for name, told in understood.informs.items() if name != slot}
                moved = replace(understood, informs={**rest, **self._spelling.of({other: value})})
                found = self._acting.hear(before, moved)
                if not self._control.records.best(full(found))[2]:
                    return moved, found
        is_stuck = self._control.is_stuck(state)
        if is_stuck and (part := self._proposals.within(state)):
            timed = replace(understood, informs={**understood.informs, **part})
            found = self._acting.hear(before, timed)
            if not self._control.is_stuck(found):
                return timed, found
        return understood, state
