"""A person who types acts instead of sentences."""

from pathlib import Path

import yaml

from bbq_torchrl.people.language import MAX_CHARACTERS, Frame, TextError, Unclear, Understood

HOSTILE = [
    *yaml.safe_load(Path(__file__).with_name("hostile.yaml").read_text("utf-8")),
    *("9" * 400, "x" * MAX_CHARACTERS, "7 " * (MAX_CHARACTERS // 2)),
]


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
        try:
            return Understood(Frame.parse(text), 0.99)
        except ValueError:  # a clause of an act
            return Understood(Frame("inform"), 0.2)

    def asks(self, understood):
        return understood.confidence < 0.7 or bool(understood.unclear)
