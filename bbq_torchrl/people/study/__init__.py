"""A human study in the browser: participants talk with agents, blindly, and rate them.

``bbq study`` is the command line; it needs the extra ``study``. The agents are a
:class:`~bbq_torchrl.people.dialogue.Talker`: this package needs neither networks nor language.
"""

from __future__ import annotations

from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.dialogue import Belief, Beliefs, Reply, Talker
from bbq_torchrl.people.study.plan import Study, StudyError, load_study

__all__ = ["Belief", "Beliefs", "Frame", "Reply", "Study", "StudyError", "Talker", "load_study"]
