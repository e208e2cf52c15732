"""Checks of every request before the pages see it, and the headers of every response."""

from __future__ import annotations

import asyncio
import logging
from http import HTTPStatus
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl

from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect, Request

from bbq_torchrl.people.study.conversations import RefusedError
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.responses import Response
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from bbq_torchrl.people.study.address import Address

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
    # The links are secret; with "no-referrer", browsers would post from the origin "null".
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}


_log = logging.getLogger(__name__)


class Guard:
    """Refuses forms that are foreign, too large, too slow or unreadable; sets the headers.

    The fields of a form are in ``request.state.form``. Pages are served with and without the
    prefix of the study's address, and with and without a slash at the end.

    Args:
        app: the application that answers.
        page: makes a page from a status and a sentence.
        address: the study's address.
    """

    def __init__(
        self, app: ASGIApp, page: Callable[[HTTPStatus, str], Response], address: Address
    ) -> None:
        self._app, self._page, self._address = app, page, address
        self._has_warned = False

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answers a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        scope = {**scope, "path": self._address.inner(scope["path"])}
        app: ASGIApp = self._app
        if scope["method"] not in ("GET", "HEAD"):
            try:
                request = Request(scope, receive)
                body = await _body(request)  # first: a client still sending reads no response
                self._check_origin(request)
                scope.setdefault("state", {})["form"] = _fields(request, body)
            except ClientDisconnect:
                return  # half a form: nobody reads a response
            except RefusedError as error:
                app = self._page(error.status, str(error))
                app.headers["connection"] = "close"
        await app(scope, receive, send_with_headers)

    def _check_origin(self, request: Request) -> None:
        """Refuses a form from another site.

        Raises:
            RefusedError: it is from another site.
        """
        origin, host = request.headers.get("origin"), request.headers.get("host")
        if origin is None or self._address.is_own(origin, host):
            return
        if not self._has_warned:  # once: anybody can send such forms
            _log.warning(
                "a form from %s was refused, since this server is called %s; if people reach the "
                "study by the former, set url in the study file (told once)",
                *(shown(origin), shown(host)),
            )
            self._has_warned = True
        raise RefusedError(HTTPStatus.FORBIDDEN, "This form was sent from another site.")


def _fields(request: Request, body: bytes) -> dict[str, str]:
    """Returns the fields of a form.

    Raises:
        RefusedError: it is not a form.
    """
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/x-www-form-urlencoded":
        raise RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "A form was expected.")
    return dict(parse_qsl(body.decode("latin-1"), keep_blank_values=True, errors="replace"))


async def _body(request: Request) -> bytes:
    """Returns the body of a request.

    Raises:
        ClientDisconnect: the client disconnected before it arrived.
        RefusedError: it is too large or too slow.
    """
    body, size = b"", 0

    async def read() -> None:
        nonlocal body, size
        async for chunk in request.stream():
            size += len(chunk)
            if size <= MAX_BODY:  # the rest is read and discarded
                body += chunk

    try:
        await asyncio.wait_for(read(), BODY_SECONDS)
    except asyncio.TimeoutError:
        raise RefusedError(
            HTTPStatus.REQUEST_TIMEOUT,
            f"The form took more than {BODY_SECONDS:g} seconds to arrive: send it again.",
        ) from None
    if size > MAX_BODY:
        raise RefusedError(
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            f"The form is too large: {MAX_BODY:,} bytes are allowed.",
        )
    return body
