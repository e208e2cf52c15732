"""Trained agents as the talker of a human study."""

from __future__ import annotations

import hashlib
import threading
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.chat.agent import TrainedAgent
from bbq_torchrl.chat.partner import Partner, as_act
from bbq_torchrl.chat.spelling import Spelling
from bbq_torchrl.language import Generator, load_phrases
from bbq_torchrl.language.kept import kept_understander, language_key
from bbq_torchrl.runs.shipped import run_folder
from bbq_torchrl.study import Reply, StudyError

if TYPE_CHECKING:
    from bbq_torchrl.study import Study


class AgentTalker:
    """The agents of a study, of run folders or shipped: text in, text out, frames and beliefs.

    Without an understander in the user's cache it is trained first, in about a minute.

    Args:
        study: whose agents; a run folder is looked for from the study file's folder on.

    Attributes:
        domain: the study's, in the spelling that all acts have.
        labels: how people call the domain's slots.

    Raises:
        StudyError: with every agent that cannot be loaded, or is of another domain.
        ModuleNotFoundError: the extra ``language`` is not installed.
    """

    def __init__(self, study: Study) -> None:
        ears, mouth = kept_understander(study.domain), Generator(study.domain)
        self._language = language_key(study.domain)
        self.labels = load_phrases(study.domain).names
        spelling = Spelling(study.domain)
        self.domain = spelling.domain
        # The tagger is not safe to be used by several threads at once.
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
            below = study.terms.ask_below.get(name)
            self._partners[name] = Partner(agent, ears, mouth, spelling, ask_below=below)
        if faults:
            raise StudyError(str(study.path), faults)

    def fingerprint(self, agent: str) -> str:
        """Returns a hash of the agent's weights, its domain and the language."""
        weights = self._partners[agent].agent.fingerprint()
        return hashlib.sha256(f"{weights} {self._language}".encode()).hexdigest()

    def reply(self, agent: str, state: str | None, text: str, seed: int) -> Reply:
        """Answers a text; see :class:`~bbq_torchrl.study.Talker`."""
        partner = self._partners[agent]
        with self._lock:
            answer = partner.reply(state, text, seed)
            beliefs = partner.beliefs(state, answer.heard, seed) if answer.acted else None
        confidence = None if answer.understood is None else answer.understood.confidence
        return Reply(
            text=answer.text,
            heard=as_act(answer.heard, confidence),
            said=as_act(answer.said),
            ended=answer.ended in ("agent", "person"),  # the study counts turns itself
            state=answer.memory,
            beliefs=beliefs,
        )


def make_talker(study: Study) -> AgentTalker:
    """Returns the agents of a study with the own language layer, on one thread of torch."""
    torch.set_num_threads(1)
    return AgentTalker(study)
