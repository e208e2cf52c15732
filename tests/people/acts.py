"""A person who types acts instead of sentences."""

from __future__ import annotations

from bbq_torchrl.people.language import Frame, TextError, Unclear, Understood


class Acts:
    """Understands acts as transcripts write them; not ``?``, and a godzilla is two movies."""

    def __call__(self, text, question=None):
        if text.startswith("\x00"):
            raise TextError("a message must have at least one character")
        if text == "?":
            return Understood(Frame("inform"), 0.2)
        if text == "two for godzilla":
            unclear = Unclear("moviename", "godzilla", ("godzilla minus one", "godzilla x kong"))
            return Understood(Frame("inform", {"numberofpeople": "2"}), 0.9, (unclear,))
        if text == "the first":
            return Understood(Frame("inform", {question.requests[0]: question.choices[0]}), 0.9)
        return Understood(Frame.parse(text), 0.99)

    def asks(self, understood):
        return understood.confidence < 0.7 or bool(understood.unclear)
