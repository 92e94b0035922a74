"""The viewer's server: for this machine alone, and only what the viewer is made of.

It listens on 127.0.0.1. A page of elsewhere could make a browser ask it (by its address, or by a name that was made to
lead here), so requests are refused whose `Host` is no name of this machine, whose `Origin` is another, or that the
browser says come from another site. Nothing is looked up on disk: three files of the package are served from memory.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import fields
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from ..errors import HandbenchError, InputError, shortened
from ..terminal import printable
from .session import Glance, Session

_PAGE = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/viewer.js": ("viewer.js", "text/javascript; charset=utf-8"),
    "/viewer.css": ("viewer.css", "text/css; charset=utf-8"),
}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_WAIT = 30.0  # seconds for a request to arrive


class Server(ThreadingHTTPServer):
    """Serves one session on a port of 127.0.0.1; 0 takes any that is free.

    Raises `InputError` for a port that cannot be used.
    """

    daemon_threads = True

    def __init__(self, session: Session, port: int = 0) -> None:
        self.session = session
        self.page = {path: (files(__package__) / "page" / name).read_bytes() for path, (name, _) in _PAGE.items()}
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or error
            raise InputError(f"port {port} cannot be used ({why}); choose another with --port") from error

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), ConnectionError):  # the page has moved on
            super().handle_error(request, client_address)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/"

    @property
    def hosts(self) -> tuple[str, ...]:
        """The names under which it may be asked."""
        return (f"127.0.0.1:{self.server_port}", f"localhost:{self.server_port}")


class _Handler(BaseHTTPRequestHandler):
    server: Server
    timeout = _WAIT
    disable_nagle_algorithm = True  # else a picture waits 40 ms until its headers are acknowledged
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "handbench", ""

    def do_GET(self) -> None:
        if (reason := self._refusal()) is not None:
            self._answer(HTTPStatus.FORBIDDEN, "text/plain; charset=utf-8", f"refused: {reason}\n".encode())
            return
        parts = urlsplit(self.path)
        try:
            self._found(parts.path, dict(parse_qsl(parts.query, max_num_fields=20)))
        except (HandbenchError, ValueError) as error:
            self._json({"error": printable(str(error))}, HTTPStatus.UNPROCESSABLE_ENTITY)

    def _found(self, path: str, query: dict[str, str]) -> None:
        session = self.server.session
        if path in _PAGE:
            self._answer(HTTPStatus.OK, _PAGE[path][1], self.server.page[path])
        elif path == "/state":
            self._json(session.described())
        elif path == "/picture":
            drawn = session.draw(_view(query))
            self._answer(HTTPStatus.OK, "image/jpeg", drawn.jpeg, {"X-Milliseconds": f"{drawn.ms:.1f}"})
        elif path == "/light":
            view = _view({"avatar": "0", **query})
            self._answer(HTTPStatus.OK, "image/jpeg", session.thumbnail(view.light, view.turn))
        else:
            self._answer(HTTPStatus.NOT_FOUND, "text/plain; charset=utf-8", b"there is nothing here\n")

    def _refusal(self) -> str | None:
        """Why a request is not answered; None: it comes from this machine's own page."""
        hosts = self.server.hosts
        if self.headers.get("Host", "").lower() not in hosts:
            return "the host is no name of this machine"
        origin = self.headers.get("Origin")
        if origin is not None and origin.lower() not in {f"http://{host}" for host in hosts}:
            return "the page that asks is another one"
        if self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            return "the page that asks is another one"
        return None

    def _json(self, value: Any, status: HTTPStatus = HTTPStatus.OK) -> None:
        self._answer(status, "application/json", json.dumps(value, allow_nan=False).encode())

    def _answer(self, status: HTTPStatus, kind: str, body: bytes, more: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(body)), **_HEADERS, **(more or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged: there are many, and their texts are the browser's."""


def _view(query: dict[str, str]) -> Glance:
    """The view that a query asks for. Raises `InputError` for an unknown name, or a value that is no number."""
    known = {field.name: field.type for field in fields(Glance)}
    values: dict[str, Any] = {}
    for name, text in query.items():
        if name not in known:
            raise InputError(f"unknown part of a view: {shortened(name)}")
        try:
            value = int(text) if known[name] == "int" else float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or abs(value) > 1e9:
            raise InputError(f"{name} is {shortened(text)}; give a number")
        values[name] = value
    if "avatar" not in values:
        raise InputError("a view is of an avatar; give its number")
    return Glance(**values)
