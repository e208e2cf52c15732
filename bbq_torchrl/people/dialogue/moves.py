"""Moves that a person makes with words alone: accepting, taking wishes back, asking for others."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from bbq_torchrl.people.language.quantities import COUNT_WORDS, PART_WORDS
from bbq_torchrl.people.language.words import SMALL, legible, tokenize

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from bbq_torchrl.people.language.lexicon import Lexicon

_DATA = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))


def _pattern(text: str) -> re.Pattern[str]:
    """Returns a compiled pattern of the file; lines break for a space, or after a ``|``."""
    for short, long in (
        ("|\n", "|"),
        ("\n", " "),
        *((f"<{n}>", _DATA[n]) for n in ("it", "yes", "is_end", "is_later")),
    ):
        text = text.replace(short, long)
    return re.compile(re.sub(r"(?<!P)<x>", r"(?P<x>[\\w' ]+?)", text))


_ACCEPT = [_pattern(rf"(?<!\S)(?:{text})(?!\S)") for text in _DATA["accept"]]
_BESIDE, _VAGUE = (frozenset(_DATA.pop(name).split()) for name in ("beside", "vague"))
_YES = _pattern(r"(?:<yes>)(?![\w']) ?(?:(?:and|but|so|then) )*")
_BEFORE = [_pattern(rf"\b(?:{text})\b(?P<x>.*)") for text in _DATA["before"]]
_AFTER = [_pattern(rf"(?P<x>.*?)(?: |(?='s))(?:{text})(?!\w)") for text in _DATA["after"]]
_FIND = {name: _pattern(text) for name, text in _DATA.items() if isinstance(text, str)}
_CLAUSE = re.compile(r" ?(?:[,.;!?()]|:(?!\d)) ?| (?:but|and then) ")
_SENTENCE = re.compile(r"[^.;!?]+[.;!? ]*")  # also "yes ! !"
_NEXT = re.compile(
    r" (?:,(?: and| but| also| so)*|(?:and|but|also)(?: also)?) "
    r"(?=(?:is|are|does|do|will|can|wh\w+(?:'s)?|how)(?!\S)(?! (?:it|that) \?))"
    r"|(?<=later|rlier) or (?=(?:another|a different|other)\b)"
)
_PIECE = re.compile(r"[^,.;!?]+[,.;!? ]*")
_AND = re.compile(rf"(?:{_CLAUSE.pattern})(?:and |also |plus )*| (?:and|n|also|plus|&) ")
_WHERE = re.compile(r" (?:in|at|on|near) ")
_GREETING = re.compile(r"^\W*(?:good )?(?:morning|afternoon|evening)\b(?: \w+)?\W*!\W*(?=\w)", re.I)
_NOTHING = re.compile(r"\bnothing\b(?=[^.;!?]*\?)", re.IGNORECASE)
_NOT = re.compile(r"\b(is|are|was|were|do|does|did|ca|wo|has|have|would|could|should)nt\b")
_LONGEST = 6  # words of a value


def _words(text: str) -> str:
    return _NOT.sub(r"\1n't", " ".join(tokenize(legible(text))))


def says(text: str, *names: str) -> bool:
    """Returns whether a text has words of one of some patterns of the file.

    Examples:
        >>> [says(text, "untold") for text in ("how long is the show?", "How far is it?")]
        [True, False]
        >>> [says(text, "whether") for text in ("Is it on Friday?", "At 7, right?", "And 7?")]
        [True, True, False]
        >>> [says(text, "restart") for text in ("start over", "forget all of it", "forget it")]
        [True, True, False]
    """
    return bool(text) and any(_FIND[name].search(_words(text)) for name in names)


def said_of(text: str) -> str:
    """Returns what a question whether says of its subject, as "far ?" of "is the theater far?"."""
    return _FIND["says_of"].split(_words(text), maxsplit=1)[-1]


def accepts(text: str) -> bool:
    """Returns whether a text accepts an offer and says nothing else.

    Examples:
        >>> [accepts(text) for text in ("ok, book it please", "that works for me", "never mind")]
        [True, True, False]
        >>> [accepts(text) for text in ("ok, how do I get there?", "ok but let me check with her")]
        [False, False]
    """
    words, is_yes = f" {_words(text)} ", False
    for pattern in _ACCEPT:
        words, count = pattern.subn(" ", words)
        is_yes = is_yes or count > 0
    return is_yes and set(words.split()) <= _BESIDE


def is_filler(text: str) -> bool:
    """Returns whether a text has only words that say nothing by themselves, such as "hmm"."""
    words = _words(text).split()
    return {*words} <= _BESIDE and not accepts(text)


def is_passing(detail: str) -> bool:
    """Returns whether a detail is said in passing: "around here", "with my kids"."""
    return is_filler(detail) or {*tokenize(detail)} <= COUNT_WORDS


def beside_yes(text: str) -> str | None:
    """Returns what a text says beside a yes, which may be nothing; ``None`` without a yes.

    In a text that says more, only a word such as "yes" or "ok" that begins a clause is a yes.

    Examples:
        >>> beside_yes("yes I'll take that, 6 of us. what time?")
        '6 of us . what time ?'
        >>> beside_yes("One ticket. Yes please"), beside_yes("yes albany"), beside_yes("at 7")
        ('one ticket .', 'albany', None)
    """
    if accepts(text):
        return ""
    if says(text, "no"):
        return None
    rest, is_yes = [], False
    for piece in _PIECE.findall(_words(text)):
        said = piece.strip()
        if not said.strip(" ,.;!?"):
            continue
        begins = _YES.match(f"{said} ")
        is_yes = is_yes or begins is not None  # "Two tickets, please" is none
        if "?" in said or not accepts(said):
            rest.append(said[begins.end() :] if begins else said)
    return " ".join(rest) if is_yes else None


def begins_with(text: str, words: str) -> bool:
    """Returns whether some words are the first of a text that has more: "nope, at seven"."""
    return _words(text).startswith(f"{words} ")


def ends_in_yes(text: str) -> bool:
    """Returns whether the last words, or the last sentence, accept: "oh well, yes".

    Examples:
        >>> [ends_in_yes(text) for text in ("oh well, yes", "two, please", "Friday. We accept")]
        [True, False, True]
    """
    words = _words(text)
    return any(_is_yes("".join(part.findall(words)[-1:])) for part in (_PIECE, _SENTENCE))


def takes(text: str) -> bool:
    """Returns whether a text accepts, or ends in a yes and asks nothing."""
    return accepts(text) or (ends_in_yes(text) and "?" not in without_yes(text))


def without_yes(text: str) -> str:
    """Returns the sentences of a text that are more than a yes: none of "yeah? I said yes"."""
    return " ".join(one for one in sentences(text) if not accepts(one.strip(" ?")))


def _is_yes(words: str) -> bool:
    """Returns whether words accept, and are not only polite."""
    return accepts(words) and not says(words, "polite")


def given(text: str) -> list[str]:
    """Returns the words of a condition, without those that name nothing.

    Examples:
        >>> given("sure, as long as it's all 8 of us sitting together")
        ['8', 'sitting', 'together']
        >>> given("ok, take it, if you could")
        []
    """
    if not says(text, "given"):
        return []
    condition = _CLAUSE.split(_FIND["given"].split(_words(text))[-1])[0]
    return _FIND["given_of_it"].sub(" ", condition).split()


def asks_whether_any(text: str) -> bool:
    """Returns whether a text asks if there is a booking of some sort.

    Examples:
        >>> [asks_whether_any(text) for text in ("Is it on in Reno?", "Got any left?", "At 7?")]
        [True, True, False]
    """
    return any(_FIND["whether_any"].search(sentence) for sentence in sentences(text))


def sentences(text: str) -> list[str]:
    """Returns the sentences of a text; a yes before a comma and a further question are such.

    Examples:
        >>> sentences("Sounds good, is it in 3D? We are four.")
        ['sounds good', 'is it in 3d ?', 'we are four .']
        >>> sentences("When is it and does it have subtitles?")
        ['when is it', 'does it have subtitles ?']
    """
    found: list[str] = []
    for whole in _SENTENCE.findall(_FIND["tag_after"].sub(" ,", _words(text))):
        for sentence in _NEXT.split(whole.strip()):
            yes, _, rest = sentence.partition(" , ")
            wish, _, tag = sentence.rpartition(" , ")
            if rest and accepts(yes):
                found += [f"{yes} ,", rest]
            elif wish and says(wish, "wish") and says(tag, "tag"):
                found += [wish, tag]  # "we want 3D, Dune is in 3D, right?"
            else:
                found.append(sentence)
    return found


def questions(text: str) -> list[str]:
    """Returns the clauses of the sentences that ask something, unless one is the whole text.

    Examples:
        >>> questions("Where, and on what day?")
        ['where', 'on what day']
        >>> questions("Friday then. When is it on?"), questions("When is it on?")
        (['when is it on'], [])
    """
    whole = _SENTENCE.findall(_words(text))
    asking = filter(_FIND["question"].search, whole)
    clauses = [part for sentence in asking for part in _AND.split(sentence.strip()) if part]
    return clauses if max(len(clauses), len(whole)) > 1 else []


def after_restart(text: str) -> str:
    """Returns what a text that starts over says next: "two for dune" of "reset: two for dune"."""
    rest = _FIND["restart"].split(_words(text))[-1].strip(" ,.;:!-")
    return "" if is_filler(rest) or accepts(rest) else rest


def is_nothing(text: str) -> bool:
    """Returns whether a text is an answer that names nothing, such as "no, not really"."""
    return _FIND["nothing"].fullmatch(_plain(text)) is not None


def _plain(text: str) -> str:
    """Returns the words of a text without marks."""
    return " ".join(word for word in _words(text).split() if word.isalpha() or "'" in word)


def about(text: str) -> str:
    """Returns ``"help"`` or ``"bot"`` for a text that asks only about the system, else ``""``."""
    return next((name for name in ("help", "bot") if _FIND[name].fullmatch(_plain(text))), "")


def direction(text: str, later: str = "later", earlier: str = "earlier") -> int:
    """Returns 1 for a text that asks for something later, -1 for earlier, else 0."""
    return says(text, later) - says(text, earlier)


def others(text: str) -> str:
    """Returns the words by which a text asks for alternatives, to the end of the clause.

    Examples:
        >>> others("Too far. What other days do you have?"), others("at 7")
        ('what other days do you have', '')
    """
    found = (_FIND["others"].search(clause) for clause in _CLAUSE.split(_words(text)))
    return next((one.string[one.start() :] for one in found if one), "")


def is_relative(value: str) -> bool:
    """Returns whether a value is one of others by its words, such as "the last show"."""
    return bool(others(value)) or says(value, "latest", "earliest")


def same(words: str) -> str:
    """Returns the part of the words of :func:`others` that names what stays, as "at that time"."""
    return " ".join(_FIND["same"].findall(words))


def without_verbs(text: str) -> str:
    """Returns a text without what is being done, as "are showing", which names nothing."""
    return _FIND["verb"].sub(" ", _words(text))


def plain(text: str) -> str:
    """Returns a text without a greeting or a complaint, that asks for anything where for nothing.

    A complaint is what it says of a time that is too late, if it says more.

    Examples:
        >>> plain("is there nothing in the evening?"), plain("9:20 is a bit late")
        ('is there anything in the evening?', '9:20 is a bit late')
        >>> plain("9 is too late for children. the 2:35, is it still there?")
        '. the 2:35 , is it still there ?'
    """
    text = _NOTHING.sub("anything", _GREETING.sub("", text))
    if not is_filler(rest := _FIND["not_part"].sub("", _words(text))):
        text = rest.strip() if rest != _words(text) else text
    rest = _FIND["complaint"].sub("", _words(text))
    is_more = rest != _words(text) and (any(map(str.isdigit, rest)) or says(rest, "but_yes"))
    return rest.strip() if is_more else text


def without_question(text: str) -> str:
    """Returns a text without the question that ends it, if it says something before."""
    *said, last = _SENTENCE.findall(text)
    return "".join(said) if said and "?" in last else text


def after_other(words: str) -> list[str]:
    """Returns the words of :func:`others` that begin with "other" or the like."""
    return _FIND["other"].findall(words)


def besides(words: str) -> list[str]:
    """Returns the words of :func:`others` for what is wanted, and those for what is not, if any.

    Examples:
        >>> besides("anything else tonight besides barbie")
        ['anything else tonight ', ' barbie']
    """
    return _FIND["besides"].split(words, maxsplit=1)


def taken_back(text: str, held: Mapping[str, str], lexicon: Lexicon) -> tuple[str, ...]:
    """Returns the slots whose wish a text takes back, or that it says do not matter.

    Args:
        text: the person's text.
        held: the values that the tracker holds.
        lexicon: the domain's phrases and values.
    """
    found: list[str] = []
    if _FIND["except"].search(_words(text)):  # a value is excluded
        return ()
    asked = " ".join(filter(asks_whether_any, sentences(text)))
    for clause in _CLAUSE.split(_words(text)):
        for match in _FIND["any"].finditer(clause):
            if match[0] not in asked:  # "Any good movies?"
                free = _FIND["stops"].split(_WHERE.split(match["x"])[0])[0]
                if not lexicon.full_names(free.split()[:2]):  # "any 3D films"
                    found += named_slots(free, lexicon)
        for region in _regions(clause):
            found += named_values(region, held, lexicon) or named_slots(region, lexicon)
    return tuple(dict.fromkeys(found))


def taken_words(text: str) -> list[str]:
    """Returns the words of a text for what it takes back."""
    clauses = _CLAUSE.split(_words(text))
    return [word for clause in clauses for region in _regions(clause) for word in region.split()]


def _regions(clause: str) -> Iterator[str]:
    """Yields the words of a clause that name what is taken back."""
    for match in _FIND["around"].finditer(clause):
        yield match["x"]
    for patterns in (_BEFORE, _AFTER):
        for pattern in patterns:
            if found := pattern.search(clause):
                yield _FIND["stops"].split(found["x"])[0 if patterns is _BEFORE else -1]


def named_slots(words: str, lexicon: Lexicon) -> list[str]:
    """Returns the slots for which some words have a noun, in the order of the words."""
    found, said = [], without_verbs(words).split() if words.strip() else []
    phrases = {slot: lexicon.phrases.slots[slot] for slot in lexicon.slots}
    last = {slot: of.name.lower().split()[-1] for slot, of in phrases.items()}
    nouns = {slot: {*of.nouns, last[slot]} for slot, of in phrases.items()}
    for word in said:
        forms = {word, word.removesuffix("s"), word.removesuffix("es")} - _VAGUE - SMALL
        if word.endswith("ies"):
            forms.add(f"{word[:-3]}y")
        slots = [slot for slot in phrases if forms & nouns[slot]]
        # "critics' rating" is no age rating
        most = max((len(nouns[slot].intersection(said)) for slot in slots), default=0)
        for slot in slots:
            is_main = word == last[slot] or last[slot] not in said
            if is_main and len(nouns[slot].intersection(said)) == most:
                found.append(slot)
    return found


def named_values(words: str, held: Mapping[str, str], lexicon: Lexicon) -> list[str]:
    """Returns the slots of the values that some words name: those held, or of one slot only."""
    parts, found = words.split(), []
    if len(parts) > 1 and parts[-1] in ("one", "ones"):  # "the 9:15 one"
        del parts[-1]
    for size in range(min(_LONGEST, len(parts)), 0, -1):
        for start in range(len(parts) - size + 1):
            name = " ".join(parts[start : start + size])
            if {*name.split()} <= SMALL:  # "the" is no time in the evening
                continue
            held_slots = [
                slot
                for slot in lexicon.slots
                if slot in held
                and not (lexicon.kinds[slot] == "count" and _is_mixed(name))
                and (link := lexicon.link(slot, name)).score > 0.8
                and held[slot] in link.values
            ]
            if {*name.split()} - SMALL <= PART_WORDS:  # "the evening" is no other name of tonight
                held_slots = [slot for slot in held if lexicon.kinds.get(slot) == "time"]
            only = lexicon.only_slot(name) if size > 1 or len(name) > 3 else None
            if slots := held_slots or ([only] if only else []):
                found += slots
                parts[start : start + size] = [""] * size
    return found


def _is_mixed(name: str) -> bool:
    """Returns whether a name has more than a number in it: "7pm" is no number of people."""
    return not name.isdigit() and any(map(str.isdigit, name))
