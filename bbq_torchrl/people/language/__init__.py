"""Language in and out: what a person types becomes an act, and an act becomes a sentence."""

from __future__ import annotations

from bbq_torchrl.domains.frames import ANY, Frame
from bbq_torchrl.people.language.asking import Nlu, Unclear, Understood
from bbq_torchrl.people.language.endpoint import Endpoint, EndpointGenerator, EndpointUnderstander
from bbq_torchrl.people.language.generator import Generator
from bbq_torchrl.people.language.phrases import PhrasesError, load_phrases
from bbq_torchrl.people.language.training_lines import read_lines
from bbq_torchrl.people.language.understander import Understander
from bbq_torchrl.utils.text import MAX_CHARACTERS, TextError

__all__ = [
    "ANY",
    "MAX_CHARACTERS",
    "Endpoint",
    "EndpointGenerator",
    "EndpointUnderstander",
    "Frame",
    "Generator",
    "Nlu",
    "PhrasesError",
    "TextError",
    "Unclear",
    "Understander",
    "Understood",
    "load_phrases",
    "read_lines",
]
