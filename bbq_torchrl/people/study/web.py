"""The study as a web application: plain forms, a page per step, a link per participant."""

from __future__ import annotations

import asyncio
import hmac
import logging
import secrets
from collections.abc import Mapping
from typing import Any
from urllib.parse import parse_qsl

from jinja2 import Environment, PackageLoader, StrictUndefined
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from bbq_torchrl.people.dialogue import Talker
from bbq_torchrl.people.dialogue.judge import card
from bbq_torchrl.people.study.conversations import Conversations, RefusedError, ids_of
from bbq_torchrl.people.study.database import Session, StoreError, current
from bbq_torchrl.people.study.plan import Address, Study
from bbq_torchrl.people.study.storage import ForgottenError, Store
from bbq_torchrl.utils.text import MAX_CHARACTERS, shown

JOIN, RESEARCHER = "join", "researcher"
"""The purposes of the keys in the two links that :meth:`Store.key` makes."""

_TEMPLATES = Environment(
    loader=PackageLoader("bbq_torchrl.people.study"),
    autoescape=True,
    auto_reload=False,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_log = logging.getLogger(__name__)

MAX_BODY = 16_384
"""Largest form in bytes; a message of the longest text in the widest letters has fewer."""

BODY_SECONDS = 10.0
"""The time in which a form must arrive."""

HEADERS = {
    "content-security-policy": (
        "default-src 'none'; style-src 'self'; script-src 'self'; img-src 'self'; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",  # the links are secret
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}
"""The headers of every response."""


def application(study: Study, store: Store, talker: Talker) -> Starlette:
    """Returns the web application of a study.

    Args:
        study: the study.
        store: the study's store.
        talker: the agents.
    """
    pages = _Pages(study, store, talker)
    # Pages are not coroutines: Starlette runs each in a thread.
    routes = [
        Route("/join/{key}", pages.join, methods=["GET", "POST"]),
        Route("/p/{token}", pages.now),
        Route("/p/{token}/{step}", pages.step, methods=["POST"]),
        Route("/r/{key}", pages.progress),
        Route("/r/{key}/{session}", pages.transcript),
        Mount("/static", StaticFiles(packages=[("bbq_torchrl.people.study", "static")])),
    ]
    handlers: dict[Any, Any] = {HTTPException: pages.no_page, StoreError: pages.not_stored}
    guard = Middleware(BaseHTTPMiddleware, dispatch=pages.guard)
    app = Starlette(routes=routes, middleware=[guard], exception_handlers=handlers)
    app.router.redirect_slashes = False  # its redirects ignore prefix and HTTPS
    return app


async def _body(request: Request) -> bytes:
    """Returns the body of a request, of one that is too large only the beginning."""
    body = b""
    async for chunk in request.stream():
        body = (body + chunk)[: MAX_BODY + 1]
    return body


class _Pages:
    """The pages, each a function from request to response."""

    def __init__(self, study: Study, store: Store, talker: Talker) -> None:
        self._study, self._store, self._talker = study, store, talker
        self._address = Address.of(study.terms.url)
        self._conversations = Conversations(study, store, talker)
        self._steps = {name: getattr(self._conversations, name) for name in ("say", "end", "rate")}

    async def guard(self, request: Request, answer: RequestResponseEndpoint) -> Response:
        """Refuses forms that are foreign, too large or too slow; sets the headers of all responses.

        The fields of a form are in ``request.state.form``. Pages are served with and without the
        prefix of the study's address, and with and without a slash at the end.
        """
        request.scope["path"] = self._address.inner(request.scope["path"])
        try:
            if request.method not in ("GET", "HEAD"):
                request.state.form = await self._form(request)
            response = await answer(request)
        except RefusedError as error:
            response = self._html("message", error.status, text=str(error))
        except ClientDisconnect:  # half a form: nobody reads a response
            response = Response(status_code=400)
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        return response

    async def _form(self, request: Request) -> dict[str, str]:
        """Returns the fields of a form.

        Raises:
            ClientDisconnect: the client disconnected before it arrived.
            RefusedError: it is too large, too slow, or from another site.
        """
        try:
            # First, and to its end: a client that is still sending reads no response.
            body = await asyncio.wait_for(_body(request), BODY_SECONDS)
        except asyncio.TimeoutError:
            text = f"The form took more than {BODY_SECONDS:g} seconds to arrive: send it again."
            raise RefusedError(408, text) from None
        if len(body) > MAX_BODY:
            raise RefusedError(413, f"The form is too large: {MAX_BODY:,} bytes are allowed.")
        if self._is_foreign(request):
            raise RefusedError(403, "This form was sent from another site.")
        return dict(parse_qsl(body.decode("latin-1"), keep_blank_values=True, errors="replace"))

    def _is_foreign(self, request: Request) -> bool:
        """Returns whether the browser says that a form is from a page of another site."""
        # Sent by browsers over HTTPS and to this machine, whatever a proxy makes of the host.
        if site := request.headers.get("sec-fetch-site"):
            return site not in ("same-origin", "none")
        origin, host = request.headers.get("origin"), request.headers.get("host")
        own = {self._address.origin, f"http://{host}", f"https://{host}"} - {""}
        # "null" is a page of ours in a browser that says no site, as over HTTP in a laboratory.
        if origin in (None, "null") or origin in own:
            return False
        _log.warning(
            "a form from %s was refused, since this server is called %s; if people reach the "
            "study by the former, set url in the study file",
            *(shown(origin), shown(host)),
        )
        return True

    # -- taking part -------------------------------------------------------------------------------

    def join(self, request: Request) -> Response:
        """Shows the consent form, and gives who consents their link."""
        self._check(request, JOIN)
        ids = ids_of(self._study.terms.join_parameters, request.query_params.getlist)
        status, problem = 200, ""
        if request.method == "POST":
            try:
                return self._to(self._conversations.enroll(request.state.form, ids))
            except RefusedError as error:
                status, problem = error.status, str(error)
        return self._html("consent", status, problem=problem)

    def now(self, request: Request) -> Response:
        """Shows a participant's next step."""
        return self._page(request.path_params["token"])

    def step(self, request: Request) -> Response:
        """Takes a step and shows the next page; a refused form keeps its content."""
        token, form = request.path_params["token"], request.state.form
        take = self._steps.get(request.path_params["step"])
        if take is None:
            raise HTTPException(404)
        try:
            take(token, form)
        except RefusedError as error:
            return self._page(token, error.status, str(error), form)
        except ForgottenError:
            text = "All that you wrote here is deleted, and your link leads nowhere any more."
            return self._html("message", 410, text=text)
        except Exception:
            _log.exception("a message was not answered, or a step not stored")
            problem = "This could not be answered or stored. Please send it again in a minute."
            return self._page(token, 503, problem, form, nonce=form["nonce"])
        return self._to(token)

    def _page(
        self,
        token: str,
        status: int = 200,
        problem: str = "",
        form: Mapping[str, str] | None = None,
        **again: str,
    ) -> Response:
        """Returns the page of the participant's next step."""
        sessions, form = self._store.sessions(token), form or {}
        if not sessions:
            raise HTTPException(404)
        if (session := current(sessions)) is None:
            return self._html("done", status, problem=problem)
        return self._html(
            "rate" if session.is_ended else "talk",
            status,
            token=token,
            problem=problem,
            session=session.position,
            sessions=len(sessions),
            card=self._card(session),
            exchanges=self._store.exchanges(session.id),
            **again,
            # A refused text is kept, unless it is from an earlier conversation.
            given=form if form.get("session") == str(session.position) else {},
            max_text=MAX_CHARACTERS,
        )

    # -- the researcher ----------------------------------------------------------------------------

    def progress(self, request: Request) -> Response:
        """Shows the progress. Outcomes by agent are in the report: looking early misleads."""
        self._check(request, RESEARCHER)
        counts, sessions = self._store.progress()
        begun = [session for session in reversed(sessions) if session.messages]
        return self._html("progress", key=request.path_params["key"], counts=counts, begun=begun)

    def transcript(self, request: Request) -> Response:
        """Shows a session turn by turn, with the agent's beliefs."""
        self._check(request, RESEARCHER)
        for session in self._store.progress()[1]:
            if str(session.id) == request.path_params["session"]:
                return self._html(
                    "transcript",
                    key=request.path_params["key"],
                    session=session,
                    card=self._card(session),
                    turns=self._store.exchanges(session.id),
                )
        raise HTTPException(404)

    # -- what all pages share ----------------------------------------------------------------------

    def no_page(self, request: Request, error: HTTPException) -> Response:
        """Returns the same page for any wrong or guessed link."""
        text = "There is no page here. Please check your link."
        return self._html("message", error.status_code, text=text)

    def not_stored(self, request: Request, error: StoreError) -> Response:
        """Returns the page for a study file that cannot be used."""
        _log.error("%s", error)
        text = "The study cannot be reached just now. Please try again in a minute."
        return self._html("message", 503, text=text)

    def _card(self, session: Session) -> dict[str, Any]:
        return card(self._talker.domain.goals[session.goal - 1], self._talker.labels)

    def _check(self, request: Request, purpose: str) -> None:
        given = request.path_params["key"].encode()
        if not hmac.compare_digest(given, self._store.key(purpose).encode()):
            raise HTTPException(404)

    def _html(self, template: str, status: int = 200, **values: Any) -> HTMLResponse:
        page = _TEMPLATES.get_template(f"{template}.html")
        shared = {"terms": self._study.terms, "prefix": self._address.prefix}
        text = page.render({**shared, "nonce": secrets.token_urlsafe(16), **values})
        return HTMLResponse(text, status)

    def _to(self, token: str) -> Response:
        return RedirectResponse(f"{self._address.prefix}/p/{token}", 303)
