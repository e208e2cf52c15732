"""The study as a web application: plain forms, a page per step, a link per participant."""

from __future__ import annotations

import hmac
import logging
import re
import secrets
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.responses import HTMLResponse, RedirectResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from bbq_torchrl.people.dialogue.judge import card
from bbq_torchrl.people.study.address import Address
from bbq_torchrl.people.study.conversations import Conversations, RefusedError, ids_of
from bbq_torchrl.people.study.database import StoreError
from bbq_torchrl.people.study.guard import Guard
from bbq_torchrl.people.study.records import act_text, current
from bbq_torchrl.people.study.store import ForgottenError
from bbq_torchrl.utils.text import MAX_CHARACTERS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from starlette.requests import Request
    from starlette.responses import Response

    from bbq_torchrl.people.dialogue import Talker
    from bbq_torchrl.people.study.plan import Study
    from bbq_torchrl.people.study.records import Session
    from bbq_torchrl.people.study.store import Store

JOIN, RESEARCHER = "join", "researcher"
"""The purposes of the keys in the two links that :meth:`Store.key` makes."""

_ID = re.compile("[0-9]{1,18}")
"""A session's number; more digits do not fit into an SQLite integer."""

MAX_LISTED = 1_000
MAX_BARS = 12
QUESTIONS = {  # of SCALES
    "overall": "Overall, how well did the assistant do?",
    "naturalness": "How natural was what it said?",
    "coherence": "How well did its answers fit what had been said?",
    "completion": "How well did it complete your task?",
}

_TEMPLATES = Environment(
    loader=PackageLoader("bbq_torchrl.people.study"),
    autoescape=True,
    auto_reload=False,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.filters["act"] = act_text
_log = logging.getLogger(__name__)


def application(study: Study, store: Store, talker: Talker) -> Starlette:
    """Returns the web application of a study.

    Args:
        study: the study.
        store: the study's store.
        talker: the agents.
    """
    address = Address.of(study.terms.url) if study.terms.url else Address()
    pages = _Pages(study, store, talker, address.prefix)
    # Pages are not coroutines: Starlette runs each in a thread.
    routes = [
        Route("/join/{key}", pages.consent),
        Route("/join/{key}", pages.enroll, methods=["POST"]),
        Route("/p/{token}", pages.now),
        Route("/p/{token}/{step}", pages.step, methods=["POST"]),
        Route("/r/{key}", pages.progress),
        Route("/r/{key}/{session}", pages.transcript),
        Mount("/static", StaticFiles(packages=[("bbq_torchrl.people.study", "static")])),
    ]
    handlers: dict[Any, Any] = {
        HTTPException: pages.no_page,
        StoreError: pages.not_stored,
        RefusedError: pages.refused,
    }
    guard = Middleware(Guard, page=pages.message, address=address)
    app = Starlette(routes=routes, middleware=[guard], exception_handlers=handlers)
    app.router.redirect_slashes = False  # its redirects ignore prefix and HTTPS
    return app


class _Pages:
    """The pages, each a function from request to response."""

    def __init__(self, study: Study, store: Store, talker: Talker, prefix: str) -> None:
        self._study, self._store, self._talker = study, store, talker
        self._prefix = prefix
        self._conversations = Conversations(study, store, talker)
        self._steps = {name: getattr(self._conversations, name) for name in ("say", "end", "rate")}

    # -- taking part -------------------------------------------------------------------------------

    def consent(self, request: Request) -> Response:
        """Shows the consent form."""
        self._check(request, JOIN)
        self._ids(request)
        return self._consent(HTTPStatus.OK, "")

    def enroll(self, request: Request) -> Response:
        """Gives a participant their link."""
        self._check(request, JOIN)
        ids = self._ids(request)
        try:
            token = self._conversations.enroll(request.state.form, ids)
        except RefusedError as error:
            return self._consent(error.status, str(error))
        return self._to(token)

    def now(self, request: Request) -> Response:
        """Shows a participant's next step."""
        return self._page(self._token(request))

    def step(self, request: Request) -> Response:
        """Takes a step and shows the next page; a refused form keeps its content."""
        token, form = self._token(request), request.state.form
        take = self._steps.get(request.path_params["step"])
        if take is None:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        try:
            take(token, form)
        except RefusedError as error:
            return self._page(token, error.status, str(error), form)
        except ForgottenError:
            text = "All that you wrote here is deleted, and your link leads nowhere any more."
            return self.message(HTTPStatus.GONE, text)
        except StoreError:
            _log.exception("a step could not be stored")
            status = HTTPStatus.SERVICE_UNAVAILABLE
            problem = "What you sent could not be stored. Please send it again in a minute."
        except Exception:
            _log.exception("an agent could not answer")
            status = HTTPStatus.INTERNAL_SERVER_ERROR
            problem = "The assistant could not answer. Please send your message again."
        else:
            return self._to(token)
        return self._page(token, status, problem, form, keep_nonce=True)

    def _page(
        self,
        token: str,
        status: HTTPStatus = HTTPStatus.OK,
        problem: str = "",
        form: Mapping[str, str] | None = None,
        *,
        keep_nonce: bool = False,
    ) -> Response:
        """Returns the page of the participant's next step."""
        sessions, form = self._store.sessions(token), form or {}
        if not sessions:  # forgotten by now
            raise HTTPException(HTTPStatus.NOT_FOUND)
        if (session := current(sessions)) is None:
            code, url = self._study.terms.completion_code, self._study.terms.completion_url
            return self._html("done", status, problem=problem, code=code, url=url)
        # A refused text is kept, unless it is from an earlier conversation.
        given = form if form.get("session") == str(session.position) else {}
        return self._html(
            "rate" if session.is_ended else "talk",
            status,
            token=token,
            problem=problem,
            session=session.position,
            sessions=len(sessions),
            card=self._card(session),
            exchanges=[(said.text, said.answer) for said in self._store.exchanges(session.id)],
            nonce=form.get("nonce", "") if keep_nonce else _new_nonce(),
            given=given,
            max_text=MAX_CHARACTERS,
            questions=QUESTIONS,
        )

    def _token(self, request: Request) -> str:
        """Returns a participant's token."""
        token: str = request.path_params["token"]
        if not self._store.sessions(token):
            raise HTTPException(HTTPStatus.NOT_FOUND)
        return token

    # -- the researcher ----------------------------------------------------------------------------

    def progress(self, request: Request) -> Response:
        """Shows the progress. Outcomes by agent are in the report: looking early misleads."""
        self._check(request, RESEARCHER)
        counts, sessions = self._store.progress()
        begun = [session for session in reversed(sessions) if session.messages]
        return self._html(
            "progress",
            key=request.path_params["key"],
            counts=counts,
            idle_minutes=self._study.terms.idle_minutes,
            agents=list(self._study.terms.agents),
            begun=begun,
            max_listed=MAX_LISTED,
        )

    def transcript(self, request: Request) -> Response:
        """Shows a session turn by turn, with the agent's beliefs."""
        self._check(request, RESEARCHER)
        number = request.path_params["session"]
        session = self._store.session(int(number)) if _ID.fullmatch(number) else None
        if session is None:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        return self._html(
            "transcript",
            key=request.path_params["key"],
            session=session,
            card=self._card(session),
            turns=self._store.exchanges(session.id),
            max_bars=MAX_BARS,
        )

    # -- what all pages share ----------------------------------------------------------------------

    def message(self, status: HTTPStatus, text: str) -> Response:
        """Returns a page with one sentence."""
        return self._html("message", status, text=text)

    def no_page(self, request: Request, error: HTTPException) -> Response:
        """Returns the same page for any wrong or guessed link."""
        status = HTTPStatus(error.status_code)
        if status == HTTPStatus.NOT_FOUND:
            return self.message(status, "There is no page here. Please check your link.")
        return self.message(status, "This cannot be done here. Please open your link again.")

    def refused(self, request: Request, error: RefusedError) -> Response:
        """Returns the page for a join link that cannot be used."""
        return self.message(error.status, str(error))

    def not_stored(self, request: Request, error: StoreError) -> Response:
        """Returns the page for a study file that cannot be used."""
        _log.error("%s", error)
        text = "The study cannot be reached just now. Please try again in a minute."
        return self.message(HTTPStatus.SERVICE_UNAVAILABLE, text)

    def _card(self, session: Session) -> dict[str, Any]:
        return card(self._talker.domain.goals[session.goal - 1], self._talker.labels)

    def _check(self, request: Request, purpose: str) -> None:
        given = request.path_params["key"].encode()
        if not hmac.compare_digest(given, self._store.key(purpose).encode()):
            raise HTTPException(HTTPStatus.NOT_FOUND)

    def _ids(self, request: Request) -> dict[str, str]:
        """Returns the ids in a join link."""
        return ids_of(self._study.terms.join_parameters, request.query_params.getlist)

    def _consent(self, status: HTTPStatus, problem: str) -> Response:
        terms = self._study.terms
        paragraphs = [text.strip() for text in terms.consent.split("\n\n") if text.strip()]
        return self._html(
            "consent",
            status,
            problem=problem,
            paragraphs=paragraphs,
            sessions=terms.sessions,
            retention=terms.retention,
            parameters=terms.join_parameters,
            nonce=_new_nonce(),
        )

    def _html(
        self, template: str, status: HTTPStatus = HTTPStatus.OK, **values: Any
    ) -> HTMLResponse:
        page = _TEMPLATES.get_template(f"{template}.html")
        shared = {"name": self._study.terms.name, "prefix": self._prefix}
        return HTMLResponse(page.render(**shared, **values), status)

    def _to(self, token: str) -> Response:
        return RedirectResponse(f"{self._prefix}/p/{token}", HTTPStatus.SEE_OTHER)


def _new_nonce() -> str:
    return secrets.token_urlsafe(16)
