"""A human study in the browser: people talk with agents, blindly, and rate them.

``python -m bbq_torchrl.study`` is the command line; needs the extra ``study``. Who talks is given
as a :class:`~bbq_torchrl.study.talk.Talker`: this package knows neither networks nor language.
"""

from __future__ import annotations

from bbq_torchrl.study.plan import Study, StudyError, load_study
from bbq_torchrl.study.talk import Belief, Beliefs, Frame, Reply, Talker

__all__ = ["Belief", "Beliefs", "Frame", "Reply", "Study", "StudyError", "Talker", "load_study"]
