"""A conversation with an agent: text in, text out, and the acts and beliefs between."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.frames import ANY, NO_MATCH_TEXT
from bbq_torchrl.domains.values import fold
from bbq_torchrl.people.dialogue import moves
from bbq_torchrl.people.dialogue.accepting import SURE, Accepting
from bbq_torchrl.people.dialogue.control import Control
from bbq_torchrl.people.dialogue.deciding import Deciding
from bbq_torchrl.people.dialogue.exchange import Answer, Memory, led, say, values_of
from bbq_torchrl.people.dialogue.hearing import DOUBTFUL, Hearing
from bbq_torchrl.people.dialogue.proposals import MAX_NAMED, Proposals
from bbq_torchrl.people.dialogue.questions import Questions, Told
from bbq_torchrl.people.dialogue.spelling import Spelling, is_in
from bbq_torchrl.people.dialogue.tracking import Acting, Tracking
from bbq_torchrl.people.dialogue.ways_out import WaysOut
from bbq_torchrl.people.language import Frame, TextError, Understood
from bbq_torchrl.people.language.asking import Asking
from bbq_torchrl.people.language.words import is_no, tokenize
from bbq_torchrl.simulator import Simulator

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import torch

    from bbq_torchrl.people.dialogue.trained_agent import TrainedAgent
    from bbq_torchrl.people.language import EndpointGenerator, Generator, Nlu


_BEFORE_NAMES = {"in", "near", "from", "around", "at", "see", "watch", "called", "about"}
_FEW_WORDS = 4


@dataclass(frozen=True)
class _Turn:
    """The turn that a reply answers.

    Attributes:
        before: the memory before the text.
        record: the values of the record that is proposed or offered, if any, by slot.
        question: the agent's act that the text answers.
        text: the text, without the questions that are answered already.
        words: what determines the words.
        asks: whether the whole text asks something.
    """

    before: Memory
    record: Mapping[str, str]
    question: Frame | None
    text: str
    words: dict[str, Any]
    asks: bool


class Partner:
    """An agent to talk with; it keeps no conversations, but returns a memory of each.

    Args:
        agent: the policy.
        nlu: the nlu.
        nlg: the nlg.
        spelling: the spelling of values; ``None`` for that of the agent's domain and phrases.
        ask_below: the confidence below which it says back what it understood, or asks again if
            that is nothing, between 0 (never) and 1; ``None`` for the threshold of the nlu.
        rules: the rules of the dialogue control, see
            :mod:`~bbq_torchrl.people.dialogue.control`; ``None`` for all.

    Attributes:
        agent: the policy.
        domain: the domain, in the spelling that all acts use.
        control: the rules between the policy and the nlg.

    Examples:
        >>> partner = Partner(TrainedAgent("runs/bbqn"), understand, speak)  # doctest: +SKIP
        >>> answer = partner.reply(None, "two tickets for wonka please", seed=0)  # doctest: +SKIP
        >>> answer.text  # doctest: +SKIP
        'Which city are you in?'
        >>> answer = partner.reply(answer.memory, "reno", seed=1)  # doctest: +SKIP
    """

    def __init__(
        self,
        agent: TrainedAgent,
        nlu: Nlu,
        nlg: Generator | EndpointGenerator,
        spelling: Spelling | None = None,
        *,
        ask_below: float | None = None,
        rules: Iterable[str] | None = None,
    ) -> None:
        self.agent, self._ask_below = agent, ask_below
        self._nlu, self._nlg = nlu, nlg
        self._spelling = spelling or Spelling(agent.domain)
        self.domain = self._spelling.domain
        # The agent sees the numbers of matching records, which must match in any spelling.
        simulator = Simulator(tensorize(self.domain), max_turn=agent.simulator.max_turn)
        self._tracking = Tracking(simulator, agent.active)
        self.control = Control(simulator, rules)
        minor = self.control.records.minor & ("names" in self.control.rules)
        self._free = {*self.domain.free_slots}
        self._details = {self.domain.slots[n] for n in minor.nonzero().flatten().tolist()}
        self._hear = Hearing(nlu, self._spelling, self.control.rules, self._details)
        self._questions = Questions(self._spelling, self._hear, nlg)
        self._acting = Acting(agent, self._tracking, self.control)
        self._accepting = Accepting(
            self._spelling, self._hear, self._tracking, self._acting, self.control
        )
        self._proposals = Proposals(
            self._spelling, self._tracking, self.control.records, nlg, self._acting.place
        )
        self._ways_out = WaysOut(self._proposals)
        self._deciding = Deciding(
            self._hear,
            self.control,
            self._acting,
            self._proposals,
            self._ways_out,
            self._details,
            agent.simulator.max_turn,
        )

    def reply(self, memory: Memory | None, text: str, seed: int) -> Answer:
        """Answers a text.

        Args:
            memory: the memory in the last answer; ``None`` at the start.
            text: the person's text.
            seed: the seed of everything random in the answer.
        """
        answer = self._answer(memory or Memory(), text, seed)
        shown, now = self._proposals.shown(answer.memory), answer.memory
        told = answer.answered.informs
        lacks = (s for s in self.domain.essential if told.get(s) == NO_MATCH_TEXT)
        now = replace(now, lacking=tuple(dict.fromkeys((*now.lacking, *lacks))))
        answer = replace(answer, memory=now)
        if not shown or shown in now.shown[-1:]:
            return answer
        others = (one for one in now.shown if one != shown)
        return replace(answer, memory=replace(now, shown=(*others, shown)))

    def _answer(self, before: Memory, text: str, seed: int) -> Answer:
        """Returns the answer to a text, before it is remembered what it shows."""
        rules, now = self.control.rules, replace(before, texts=before.texts + 1)
        words: dict[str, Any] = {"session": seed, "turn": now.texts}
        told, untold, whole = Told("", {}, text), "", text
        try:
            if before.state is not None and before.is_offered and self._picks(before, text):
                state = before.state.replace(offered=before.state["offered"] & False)
                before, now = replace(before, state=state), replace(now, state=state)
            is_about = bool(before.proposal) or before.is_offered
            near = self._proposals.nearest(before)
            record = near if is_about else {}
            if "answers_first" in rules:
                text = moves.plain(text)
            if "drop" in rules and moves.says(text, "restart"):
                sentence = self._nlg.say("restart", **words)
                if rest := moves.after_restart(text):
                    fresh = self._answer(Memory(texts=before.texts), rest, seed)
                    if values_of(fresh.understood):
                        return led(fresh, sentence)
                greeting = self._nlg.agent(Frame("request"), **words)
                return say(Memory(texts=now.texts), f"{sentence} {greeting}")
            if "help" in rules and (topic := moves.about(text)):
                return say(now, self._nlg.say(topic, self.domain.essential[:MAX_NAMED], **words))
            if "way_out" in rules and (found := self._back(before, now, text, words)):
                return found
            if "answers_first" in rules and not moves.takes(text):
                told = self._questions(record, text, words, near)
            question = self._question(before)
            reading = self._hear(told.rest or text, question)
            if told.text and told.rest:  # "What is the price for two?"
                free = self._hear(text, question).frame.informs.items()
                counts = {s: v for s, v in free if s in self._free}
                frame = replace(reading.frame, informs={**counts, **reading.frame.informs})
                reading = replace(reading, frame=frame)
            if told.text and told.rest and (named := self._elsewhere(before, record, told.rest)):
                untold = "" if told.values or told.is_guess else told.text
                text = told.rest if untold else text
                told, reading = Told("", {}, text), self._hear(text, question)
                frame = replace(reading.frame, informs={**named, **reading.frame.informs})
                sure = max(reading.confidence, DOUBTFUL)
                reading = replace(reading, frame=frame, confidence=sure)
            reading = self._hear.of_record(reading, record, text)
            reading, lead = self._without_strange(reading, text, question, words)
        except TextError as error:
            return self._ask_again(now, None, f"Sorry, I cannot read that: {error}.")
        if not told.text:
            is_yes = reading.takes >= SURE and "?" not in whole  # "exactly what I hoped for"
            asks = moves.says(moves.without_yes(whole), "question") and not is_yes
            turn = _Turn(before, record, question, text, words, asks)
            return led(led(self._reply(turn, reading), lead), untold)
        told = replace(told, text=f"{told.text} {lead}".strip())
        wanted = question.requests if question is not None and not is_about else ()
        answers = {s: v for s, v in values_of(reading.frame).items() if s in wanted}
        if answers and not told.rest:  # "ooh Avatar, how long is that one?"
            sure = max(reading.confidence, DOUBTFUL)
            reading = replace(reading, frame=Frame("inform", answers), confidence=sure)
            told = replace(told, rest=" ".join(answers.values()))
        is_only = (
            not told.rest
            or (moves.is_filler(told.rest) and not reading.frame.informs)
            or (not is_about and is_no(told.rest))
            or (moves.accepts(told.rest) and (before.is_offered or not told.is_yes))
        )
        if is_only and "way_out" in rules:
            found = self._ways_out.on_file(now, reading, words, told.values)
            if found is not None:
                return led(found, told.text)
        asks = moves.says(told.rest, "question", "others")
        if is_only or not (asks or self._is_news(record, reading.frame, text)):
            stands = self._nlg.say("stands", **words) if is_about else ""
            answer = say(now, stands, reading)
        else:
            turn = _Turn(before, record, question, told.rest, words, True)
            answer = self._reply(turn, reading)
            if record and not reading.unclear and answer.memory.asking.times > before.asking.times:
                answer = say(now, self._nlg.say("stands", **words), reading)
        informs = {**told.values, **answer.answered.informs}
        is_told = told.text in answer.text or (told.is_guess and self._shows_more(before, answer))
        # What one record lacks, and the other has that is told of beside it.
        is_told |= bool(told.values) and all(
            value != informs[slot] for slot, value in told.values.items()
        )
        return replace(
            answer,
            text=answer.text if is_told else f"{told.text} {answer.text}".strip(),
            answered=replace(answer.answered, act="inform", informs=informs),
        )

    def _picks(self, before: Memory, text: str) -> bool:
        """Returns whether a text picks one of a list that was told after the offer that stands."""
        question = self._question(before)
        if before.proposal or question is None or not question.choices:
            return False
        return not {*question.choices}.isdisjoint(self._hear(text, question).frame.informs.values())

    def _back(self, before: Memory, now: Memory, text: str, words: dict[str, Any]) -> Answer | None:
        """Returns the proposal of a showing that a text goes back to, and answers beside it."""
        clauses = [one for one in moves.sentences(text) if moves.says(one, "back")]
        if not (clauses and before.shown):
            return None
        reading, free = self._hear(" ".join(clauses), None), self._free
        told = {s: v for s, v in values_of(reading.frame).items() if s not in free}
        kinds = self._spelling.lexicon.kinds
        is_strange = any(kinds[one.slot] == "text" for one in reading.unclear)  # "in Anchorage"
        record = {} if is_strange else self._proposals.earlier(before, told)
        if not record:
            return None
        reading = self._hear(text, None)
        own = {s: v for s, v in values_of(reading.frame).items() if s in free}
        now = replace(now, state=self._deciding.told(before.state, Frame("inform", own))[1])
        found = self._proposals.back(now, reading, record, words)
        beside = self._questions(self._proposals.nearest(found.memory), text, words)
        return led(found, beside.text)

    def _shows_more(self, before: Memory, answer: Answer) -> bool:
        """Returns whether an answer offers or lists something else: "is 3:30 possible?"."""
        shown = self._proposals.shown(answer.memory)
        return bool(answer.answered.choices or (shown and shown != self._proposals.shown(before)))

    def _is_news(self, record: Mapping[str, str], frame: Frame, text: str) -> bool:
        """Returns whether a text says more of a record than where and when it is.

        "4:15 is early" after a question neither takes a proposal nor tells a wish.
        """
        told = values_of(frame)
        is_known = told.items() <= record.items() and told.keys() <= {*self.domain.essential}
        return not (told and is_known) or moves.says(text, "agrees")

    def _reply(self, turn: _Turn, reading: Understood) -> Answer:
        """Returns the answer to a text with a meaning."""
        before, text, rules = turn.before, turn.text, self.control.rules
        now = replace(before, texts=before.texts + 1, taken=False)
        reading = self._hear.leaving(reading, text, before.is_offered)
        is_moved = moves.direction(text) or moves.says(text, "question")
        picks = turn.question is not None and turn.question.choices
        is_picked = picks and not {*picks}.isdisjoint(reading.frame.informs.values())
        held = self._tracking.kept(before.state)
        known = {**held, **turn.record}
        is_news = any(known.get(s) != value for s, value in values_of(reading.frame).items())
        is_wish = is_news and (is_picked or not is_moved)
        others = "way_out" in rules and bool(moves.others(text)) and not is_wish
        others &= not self._is_detail(moves.others(text), reading)
        if "way_out" in rules:
            reading = self._narrowed(reading, text, before, turn.record)
        is_about = bool(before.proposal) or before.is_offered or others
        if "drop" in rules and (is_about or held or values_of(reading.frame)):
            reading, refused = self._hear.refused(reading, text, held, (turn.record, *now.shown))
            now = replace(now, refused=(*now.refused, *refused))
        spoken = reading.frame
        step = self._to_what_stands(turn, now, reading, others)
        if isinstance(step, Answer):
            return step
        now, reading, others, is_booked = step
        dropped: tuple[str, ...] = ()
        if "drop" in rules and reading.frame != Frame("thanks"):
            held |= before.asking.waiting.informs if before.asking.waiting else {}
            reading, dropped = self._hear.dropped(reading, text, turn.question, held)
        lead = self._nlg.say("dropped", dropped, **turn.words) if dropped else ""
        if others:
            reading = self._hear.without_relative(reading, text, turn.record)
            found = self._others(turn, now, reading, held, dropped)
            if found is not None:
                spoken_of = {} if found.answered.choices else self._proposals.nearest(found.memory)
                beside = self._questions(spoken_of, text, turn.words)
                found = led(led(found, beside.text), lead)
                is_open = found.memory.proposal or found.memory.is_offered or found.answered.choices
                if is_open or found.text.endswith("?"):
                    return found
                # There is no other, and nothing stands: the agent goes on.
                told = Frame("inform", values_of(reading.frame) | dict.fromkeys(dropped, ANY))
                answer = self._deciding(now, reading, told, turn.words)
                return led(answer, found.text)
        understood = before.asking.joined(reading.frame)
        is_unsure = self._is_unsure(turn, reading)
        if is_unsure and (asked := self._asked(turn, now, reading, understood)):
            return asked
        if before.proposal and understood == Frame("inform"):  # nothing is told or taken back
            return led(self._stands(turn, now, reading), lead)
        now = replace(now, asking=Asking())
        if understood.act == "closing" or understood == Frame("greeting"):
            # Not the agent's decision: a greeting is returned, a farewell ends the conversation.
            answered, ended = Frame(understood.act), "person" if understood.act == "closing" else ""
            sentence = self._nlg.agent(answered, **turn.words)
            return Answer(sentence, reading, understood, answered, now, ended=ended)
        is_list = bool(picks)
        still = self._tracking.open(before.state)
        news = [slot for slot in understood.requests if slot not in still]
        lists = news if is_list else [*news, *still]
        answer = self._deciding(
            now, reading, understood, turn.words, turn.question, is_booked=is_booked, lists=lists
        )
        is_of_it = values_of(reading.frame).items() <= turn.record.items()
        if is_of_it and not before.proposal.keys().isdisjoint(answer.answered.requests):
            # "Elemental would be lovely, but is it in 3D?" neither takes nor leaves it.
            return led(self._stands(turn, now, reading), lead)
        if before.proposal and before.proposal.items() <= understood.informs.items():
            lent = before.proposal.keys() - values_of(spoken)
            state = self._tracking.lent(answer.memory.state, before.state, lent)
            answer = replace(answer, memory=replace(answer.memory, state=state))
        answer = led(answer, lead)
        absent = self._absent(before, understood, answer)
        if absent:
            answer = led(answer, self._nlg.say("no_promise", values=absent, **turn.words))
        if (is_unsure or others) and (unsaid := self._unsaid(before, answer)):
            answer = led(answer, self._nlg.say("understood", values=unsaid, **turn.words))
        use = "" if absent or not values_of(understood) else self._whether_any(turn, answer)
        return led(answer, self._nlg.say(use, **turn.words) if use else "")

    def _whether_any(self, turn: _Turn, answer: Answer) -> str:
        """Returns the use of the answer to whether there is a booking of some sort, if any."""
        proposal, held = answer.memory.proposal, self._tracking.kept(answer.memory.state)
        is_met = all(proposal.get(slot, value) == value for slot, value in held.items())
        is_found = is_met and bool(answer.acted or answer.answered.choices or proposal)
        asking = [one for one in moves.sentences(turn.text) if moves.asks_whether_any(one)]
        if not (asking and is_found):
            return ""
        heard = [v for one in asking for v in values_of(self._hear(one, None).frame).values()]
        names = " , ".join(turn.record.values())
        # "Is there parking at the AMC?"
        is_unheard = moves.says(asking[0], "detail") and all(is_in(v, names) for v in heard)
        if is_unheard and not self._spelling.named(asking[0], self.domain.slots):
            return "unknown_question"
        return "yes" if heard or moves.says(asking[0], "running") else ""  # "is it still on?"

    def _to_what_stands(
        self, turn: _Turn, now: Memory, reading: Understood, others: bool
    ) -> Answer | tuple[Memory, Understood, bool, bool]:
        """Returns a reading as a reply to what is proposed or offered.

        Args:
            turn: the turn.
            now: the memory.
            reading: the meaning of the text.
            others: whether it asks for others.

        Returns:
            An answer, or else the memory, the reading, whether it still asks for others, and
            whether it books.
        """
        before, text, words, rules = turn.before, turn.text, turn.words, self.control.rules
        is_denied = self._hear.is_bare(reading.frame, "deny")
        is_refused = not turn.asks or moves.says(text, "no_first")
        is_no_more = is_no(text) or (is_denied and is_refused)
        is_booked = False
        if before.proposal:
            says_yes = moves.beside_yes(text) is not None or moves.ends_in_yes(text)
            takes = not others or (says_yes and not moves.says(text, "question"))
            found = self._accepting.proposed(before, turn.record, reading, text, turn.asks)
            if takes and found:
                taken, is_yes = found
                is_yes &= not moves.others(text)
                is_booked = is_yes and self._proposals.is_complete(before, values_of(taken.frame))
                return replace(now, proposal={}, taken=is_yes), taken, False, is_booked
            if is_no_more and not others:
                return self._proposals.alternative(now, reading, words)
            asked = {*reading.frame.requests} - {self.domain.ticket_slot}
            is_plain = not (others or reading.unclear or values_of(reading.frame))
            if asked and is_plain and asked <= turn.record.keys():  # "I don't know its format"
                told = Frame("inform", {slot: turn.record[slot] for slot in sorted(asked)})
                sentence = self._nlg.agent(told, turn.record, **words)
                answer = say(now, self._nlg.say("stands", **words), reading)
                return led(replace(answer, answered=told), sentence)
            is_remark = is_denied and not (is_no_more or others)  # "is it at night? 4 isn't late"
            is_remark |= self._hear.is_bare(reading.frame, "thanks", "not_sure")
            if "yes_ends" in rules and is_remark and not (others or reading.unclear):
                # A yes to what is proposed books nothing that was offered before.
                return self._stands(turn, now, reading)
        elif before.is_offered and "yes_ends" in rules and not others:
            reading, is_booked = self._accepting.offered(
                before, turn.record, reading, text, turn.asks
            )
            if reading.frame.act == "not_sure" and not reading.unclear:
                return self._stands(turn, now, reading)
        elif before.taken and values_of(reading.frame).keys() <= self._free and not turn.asks:
            is_booked = bool(values_of(reading.frame))  # "How many?" "Three"
        elif "book" in rules and moves.accepts(text) and self._hear.is_bare(reading.frame):
            reading = replace(reading, confidence=1.0)
        return now, reading, others, is_booked

    def _stands(self, turn: _Turn, now: Memory, reading: Understood) -> Answer:
        """Returns that an offer stands, after owning up to what else the text asks."""
        asks = moves.says(turn.text, "question", "given")
        lead = self._nlg.say("unknown_question", **turn.words) if asks else ""
        return led(say(now, self._nlg.say("stands", **turn.words), reading), lead)

    def _is_unsure(self, turn: _Turn, reading: Understood) -> bool:
        """Returns whether a reading is too poor to act on.

        A likely question is not, nor one that names what it asks for: "ok. when is it on?"
        """
        asked = {*reading.frame.requests} - {self.domain.ticket_slot}
        is_named = asked <= {*self._spelling.named(turn.text, asked)}
        is_plain = bool(asked) and not (reading.unclear or values_of(reading.frame))
        is_plain &= is_named or reading.confidence >= DOUBTFUL
        return not is_plain and turn.before.asking.asks(self._nlu, reading, self._ask_below)

    def _asked(
        self, turn: _Turn, now: Memory, reading: Understood, understood: Frame
    ) -> Answer | None:
        """Returns a question about a text that is understood poorly; ``None`` if it is plain."""
        text, words, rules = turn.text, turn.words, self.control.rules
        is_question = "help" in rules and moves.says(text, "question") and "?" in text
        is_unheard = self._hear.is_bare(reading.frame) or moves.says(text, "detail")
        if is_question and is_unheard and not (reading.unclear or values_of(reading.frame)):
            return say(now, self._nlg.say("unknown_question", **words), reading)
        if reading.unclear or not values_of(understood) or "confirm" not in rules:
            return self._ask_again(now, reading, self._nlg.clarify(reading, **words))
        return None

    def _is_detail(self, words: str, reading: Understood) -> bool:
        """Returns whether words that may ask for others are a detail that was heard: "nearest"."""
        told = values_of(reading.frame).items()
        found = {slot: value for slot, value in told if slot in self._details}
        lexicon, first = self._spelling.lexicon, words.split()[:2]  # "the nearest one that has it"
        return any(lexicon.place(first, slot, value) is not None for slot, value in found.items())

    def _absent(self, before: Memory, understood: Frame, answer: Answer) -> dict[str, str]:
        """Returns the wishes that are news and that the record spoken of does not have."""
        known, aside = map(self._tracking.aside, (before.state, answer.memory.state))
        if before.proposal:  # which says what its record lacks
            known = self._tracking.kept(before.state)
        names = " ".join(self._proposals.nearest(answer.memory).values())
        return {
            slot: value
            for slot, value in aside.items()
            if value not in f"{names} {fold(answer.text)}"
            if value != known.get(slot) or slot in understood.informs
            if not moves.is_passing(value)
        }

    def _others(
        self,
        turn: _Turn,
        now: Memory,
        reading: Understood,
        held: Mapping[str, str],
        dropped: tuple[str, ...],
    ) -> Answer | None:
        """Returns the alternatives that the sentences of a text ask for, if any.

        Args:
            turn: the turn.
            now: the memory.
            reading: the meaning of the text.
            held: the values told before.
            dropped: the slots whose wishes it takes back: "any day is fine. what else is there?"
        """
        lexicon, is_meant = self._spelling.lexicon, self._spelling.is_meant
        asking = [one for one in moves.sentences(turn.text) if moves.others(one)]
        if dropped:
            asking = [
                one
                for one in asking
                if moves.says(one, "something_else") or not moves.taken_back(one, held, lexicon)
            ]
            if not asking:
                return None
        times = {slot for slot, kind in lexicon.kinds.items() if kind == "time"}
        named = [
            {*moves.named_slots(moves.others(sentence), lexicon)}
            | (times if moves.direction(sentence) else set())
            for sentence in asking
        ]
        if len(asking) < 2 or not all(named[1:]) or not named[0].isdisjoint(*named[1:]):
            asking = [turn.text]
        told, known = values_of(turn.before.asking.joined(reading.frame)), {**held, **turn.record}
        changed = {s for s, v in told.items() if s not in known or not is_meant(s, v, known[s])}
        free = {slot for slot, value in reading.frame.informs.items() if value == ANY}
        wish = Frame("inform", told | dict.fromkeys((*free, *dropped), ANY))
        now = replace(now, state=self._deciding.told(turn.before.state, wish)[1])
        alternatives = (
            self._ways_out.others(now, reading, text, turn.question, turn.words, changed)
            for text in asking
        )
        found = [answer for answer in alternatives if answer is not None]
        if not found:
            return None
        # The last is what the next text replies to; there is one proposal at most.
        last = max(found, key=lambda a: (bool(a.memory.proposal), bool(a.answered.choices)))
        leads = [
            one for one in found if one is not last and one.memory.proposal in ({}, now.proposal)
        ]
        texts = [moves.without_question(answer.text) for answer in leads]
        return led(last, " ".join(one for one in texts if one not in last.text))

    def _narrowed(
        self, reading: Understood, text: str, before: Memory, record: Mapping[str, str]
    ) -> Understood:
        """Returns a reading whose names mean what fits with all that was said before."""
        held, waiting = self._tracking.kept(before.state), before.asking.waiting
        held |= values_of(waiting) if waiting else {}
        return self._ways_out.narrowed(reading, text, held, record)

    def _elsewhere(self, before: Memory, record: Mapping[str, str], rest: str) -> dict[str, str]:
        """Returns the values by which the rest of a text names another record, to ask about it."""
        heard = self._hear.of_record(self._hear(rest, None), record, rest)
        reading = self._narrowed(heard, rest, before, record)
        named = {s: v for s, v in values_of(reading.frame).items() if s not in self._free}
        is_sure = reading.confidence >= DOUBTFUL or self._spelling.is_named(rest, named)
        is_other = any(record.get(slot, value) != value for slot, value in named.items())
        return named if is_sure and is_other and not moves.asks_whether_any(rest) else {}

    def _without_strange(
        self, reading: Understood, text: str, question: Frame | None, words: dict[str, Any]
    ) -> tuple[Understood, str]:
        """Returns a reading without details that no record has, and the sentence that says so.

        So are words for a day or a time in passing: "we read it last spring. where is it on?"
        """
        kinds = self._spelling.lexicon.kinds
        details = self._details.difference(question.requests if question else ())
        if question is not None and (values_of(reading.frame) or reading.frame.requests):
            passing = {slot for slot, kind in kinds.items() if kind in ("date", "time")}
            details |= passing.difference(question.requests)
        unclear = [one for one in reading.unclear if not (one.candidates or one.is_denied)]
        names = [one.text for one in unclear if one.slot in details]
        said = [name for name in names if not moves.is_passing(name)]
        says_more = bool(values_of(reading.frame) or reading.frame.requests)
        asked = {*self.domain.opening_slots, *(question.requests if question else ())}
        asked.difference_update(reading.frame.requests)  # "I coach a team here. What is on?"
        left = tuple(
            one
            for one in reading.unclear
            if one.text not in names
            # "I wanted to avoid it" names no city.
            if one not in unclear
            or not says_more
            or one.slot in asked
            or _is_placed(one.text, text)
        )
        sentence = self._nlg.say("not_on_file", choices=said, **words) if said else ""
        return replace(reading, unclear=left), sentence

    def _question(self, before: Memory) -> Frame | None:
        """Returns the agent's act that the next text answers."""
        if before.proposal:
            return Frame("confirm_question")
        last = None if before.state is None else self._tracking.answered(before.state)
        return before.asking.question(last)

    def _unsaid(self, before: Memory, answer: Answer) -> dict[str, str]:
        """Returns the values that are news and that the answer to them does not say."""
        held = self._tracking.kept(before.state)
        known, said = {**held, **before.proposal}, fold(answer.text)
        return {
            slot: value
            for slot, value in values_of(answer.understood).items()
            if known.get(slot) != value and fold(value) not in said
        }

    def observe(self, memory: Memory | None, understood: Frame) -> torch.Tensor:
        """Returns the observation, float32 ``[F]``, on which the agent answered an act.

        Args:
            memory: the memory before the text.
            understood: the act that the agent acted on.
        """
        return self._tracking.observe(self._acting.hear((memory or Memory()).state, understood))

    def _ask_again(self, now: Memory, reading: Understood | None, sentence: str) -> Answer:
        """Returns a question about a text; the state of the dialogue is unchanged."""
        now = replace(now, asking=now.asking.again(reading))
        understood = answered = Frame("not_sure")
        if reading is not None:
            understood = reading.frame
            if reading.unclear:
                unclear = reading.unclear[0]
                answered = Frame("multiple_choice", {}, (unclear.slot,), unclear.candidates)
        return Answer(sentence, reading, understood, answered, now)


def _is_placed(name: str, text: str) -> bool:
    """Returns whether a text has a name where names are said: "in Toledo", "two, Toledo"."""
    words, first = tokenize(text), tokenize(name)[:1]
    before = [word for word, after in pairwise(["", *words]) if [after] == first]
    is_placed = any(word in _BEFORE_NAMES or not word.isalpha() for word in before)
    return is_placed or len(words) <= _FEW_WORDS
