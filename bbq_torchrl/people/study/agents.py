"""Trained agents as the talker of a human study."""

from __future__ import annotations

import hashlib
import logging
import threading
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.people.dialogue.partner import Memory, Partner
from bbq_torchrl.people.dialogue.spelling import Spelling
from bbq_torchrl.people.dialogue.trained_agent import TrainedAgent
from bbq_torchrl.people.language import Generator, load_phrases
from bbq_torchrl.people.language.phrases import GENERIC, has_own_phrases
from bbq_torchrl.people.language.understander import cached_understander, language_key
from bbq_torchrl.people.study import Reply, StudyError
from bbq_torchrl.runs.shipped import run_folder
from bbq_torchrl.utils.output import print_error

if TYPE_CHECKING:
    from collections.abc import Callable

    from bbq_torchrl.people.study import Study

_log = logging.getLogger(__name__)


class AgentTalker:
    """The agents of a study, from run folders or shipped: text in; text, frames and beliefs out.

    If the user's cache has no understander of the domain, it is trained first, in about a minute.

    Args:
        study: the study; paths of run folders are relative to the study file's folder.
        tell: called with a message when the training begins.

    Attributes:
        domain: the study's domain, in the spelling of all acts.
        labels: the readable names of the domain's slots.

    Raises:
        StudyError: if agents cannot be loaded or have another domain; it lists all of them.
        ModuleNotFoundError: the extra ``language`` is not installed.
    """

    def __init__(self, study: Study, tell: Callable[[str], None] = lambda _: None) -> None:
        nlu = cached_understander(study.domain, None, tell)
        self._language = language_key(study.domain)
        if not has_own_phrases(study.domain):
            _log.warning("the domain %s %s", study.domain.name, GENERIC)
        self.labels = load_phrases(study.domain).names
        spelling = Spelling(study.domain)
        self.domain = spelling.domain
        nlg = Generator(self.domain)
        # The tagger is not thread-safe.
        self._lock = threading.Lock()
        self._partners: dict[str, Partner] = {}
        faults = []
        for name, source in study.terms.agents.items():
            try:
                agent = TrainedAgent(run_folder(source, study.path.parent))
            except (ValueError, OSError) as error:
                faults.append(f"the agent {name} cannot be loaded: {error}")
                continue
            if agent.domain != study.domain:
                faults.append(
                    f"the agent {name} of {source} is of the domain {agent.domain.name}, which is "
                    f"not the study's, {study.domain.name}"
                )
            below, rules = study.terms.ask_below.get(name), study.terms.control.get(name)
            self._partners[name] = Partner(agent, nlu, nlg, spelling, ask_below=below, rules=rules)
        if faults:
            raise StudyError(str(study.path), faults)

    def fingerprint(self, agent: str) -> str:
        """Returns a hash of the agent's weights, its domain, the language and the rules."""
        partner = self._partners[agent]
        parts = (partner.agent.fingerprint(), self._language, *partner.control.rules)
        return hashlib.sha256(" ".join(parts).encode()).hexdigest()

    def reply(self, agent: str, state: str | None, text: str, seed: int) -> Reply:
        """Answers a text; see :class:`~bbq_torchrl.people.study.Talker`."""
        partner = self._partners[agent]
        with self._lock:
            memory = None if state is None else Memory.from_json(state)
            answer = partner.reply(memory, text, seed)
            beliefs = partner.beliefs(memory, answer.understood, seed) if answer.acted else None
        confidence = None if answer.reading is None else answer.reading.confidence
        return Reply(
            text=answer.text,
            understood=answer.understood,
            answered=answer.answered,
            confidence=confidence,
            ended=answer.ended in ("agent", "person"),  # the study counts turns itself
            state=answer.memory.to_json(),
            beliefs=beliefs,
        )


def make_talker(study: Study) -> AgentTalker:
    """Returns the agents of a study with this package's language layer; torch uses one thread."""
    torch.set_num_threads(1)
    return AgentTalker(study, tell=print_error)
