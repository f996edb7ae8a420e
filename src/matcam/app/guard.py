"""Access control of the app: every request is checked first, including requests for a websocket.

- The Host header must be an address of this server. This prevents access by a page of another server whose host name was
  redirected to this machine (DNS rebinding).
- An Origin header, if present, must contain the same address; a request for a websocket must have an Origin header.
- The first request must contain the token in its address. The answer redirects to an address without the token, and sets a
  cookie. All other requests must contain this cookie.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from tornado.httputil import (
    HTTPConnection,
    HTTPHeaders,
    HTTPMessageDelegate,
    HTTPServerConnectionDelegate,
    RequestStartLine,
    ResponseStartLine,
)

_LOOPBACK = ("127.0.0.1", "localhost")
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src 'self' blob:; connect-src 'self' {sockets}; form-action 'none'; "
    "base-uri 'none'; frame-ancestors 'none'; object-src 'none'"
)


class Guard(HTTPServerConnectionDelegate):
    """Filter that passes permitted requests to the application, and answers all others itself.

    Args:
        application: application that receives the accepted requests.
        host: address of the server.
        port: port of the server.
    """

    def __init__(self, application: Any, host: str, port: int):
        self.application = application
        self.host = host
        self.port = port
        self.token = secrets.token_urlsafe(32)
        self._key = secrets.token_urlsafe(32)
        self._cookie = f"matcam-{port}"

    @property
    def address(self) -> str:
        """Address to open, including the token."""
        host = "127.0.0.1" if self.host in ("127.0.0.1", "0.0.0.0", "::") else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/?token={self.token}"

    def start_request(self, server_conn: object, request_conn: HTTPConnection) -> HTTPMessageDelegate:
        return _Request(self, server_conn, request_conn)

    def on_close(self, server_conn: object) -> None:
        self.application.on_close(server_conn)

    def answer(self, line: RequestStartLine, headers: HTTPHeaders) -> tuple[int, HTTPHeaders, str] | None:
        """Check a request, and build the answer unless the request is accepted.

        Returns:
            Status, headers and body of a rejection, or of the redirection to the address without the token. None: the
            request is accepted.
        """
        host = headers.get("Host", "").lower()
        if headers.get_list("Host")[1:] or not self._is_own(host):
            return _refusal("this host name is not that of the app: open the address that `matcam app` printed")
        origins = headers.get_list("Origin")
        if any(origin.lower() != f"http://{host}" for origin in origins):
            return _refusal(
                "this request comes from a page of another server: open the address that `matcam app` printed"
            )
        if headers.get("Upgrade", "").lower() == "websocket" and len(origins) != 1:
            return _refusal("a websocket must have an Origin header: open the address that `matcam app` printed")
        target = urlsplit(line.path)
        given = parse_qs(target.query).get("token", [])
        if len(given) == 1 and line.method == "GET" and _same(given[0], self.token):
            cookie = f"{self._cookie}={self._key}; Path=/; HttpOnly; SameSite=Strict"
            return 303, HTTPHeaders({"Location": "/", "Set-Cookie": cookie}), ""
        if not _same(self._cookie_of(headers), self._key):
            return _refusal("the token is missing: open the address that `matcam app` printed")
        return None

    def secure(self, headers: HTTPHeaders) -> None:
        names = _LOOPBACK if self.host == "127.0.0.1" else (*_LOOPBACK, self.host)
        sockets = " ".join(f"ws://{name}:{self.port}" for name in names if ":" not in name)
        headers["Content-Security-Policy"] = _POLICY.format(sockets=sockets)
        headers["Referrer-Policy"] = "no-referrer"
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        headers.setdefault("Cache-Control", "no-store")  # scripts with their version in the address have other rules

    def _is_own(self, host: str) -> bool:
        name, _, port = host.rpartition(":")
        if port != str(self.port):
            return False
        if name in _LOOPBACK or name.strip("[]") == self.host.lower():
            return True
        if self.host not in ("0.0.0.0", "::"):
            return False
        try:  # the server listens on all addresses; a numeric address cannot be a foreign name
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return True

    def _cookie_of(self, headers: HTTPHeaders) -> str:
        try:
            morsel = SimpleCookie(headers.get("Cookie", "")).get(self._cookie)
        except CookieError:
            return ""
        return morsel.value if morsel else ""


def _same(given: str, secret: str) -> bool:
    return hmac.compare_digest(given.encode(), secret.encode())


def _refusal(why: str) -> tuple[int, HTTPHeaders, str]:
    return 403, HTTPHeaders({"Content-Type": "text/plain; charset=utf-8"}), f"refused: {why}\n"


class _Request(HTTPMessageDelegate):
    """Request that is passed to the application, or answered without it."""

    def __init__(self, guard: Guard, server_conn: object, connection: HTTPConnection):
        self.guard = guard
        self.server_conn = server_conn
        self.connection = connection
        self.inner: HTTPMessageDelegate | None = None
        self.refused: tuple[int, HTTPHeaders, str] | None = None

    def headers_received(self, start_line: Any, headers: HTTPHeaders) -> Any:
        self.refused = self.guard.answer(start_line, headers)
        if self.refused is None:
            secured: Any = _Secured(self.guard, self.connection)
            self.inner = self.guard.application.start_request(self.server_conn, secured)
            return self.inner.headers_received(start_line, headers)
        self._refuse(*self.refused)  # before the body is read, because the connection closes with the answer
        return None

    def data_received(self, chunk: bytes) -> Any:
        return self.inner.data_received(chunk) if self.inner else None

    def finish(self) -> None:
        if self.inner:
            self.inner.finish()

    def _refuse(self, code: int, headers: HTTPHeaders, text: str) -> None:
        body = text.encode()
        headers["Content-Length"] = str(len(body))
        headers["Connection"] = "close"
        self.guard.secure(headers)
        line = ResponseStartLine("HTTP/1.1", code, "See Other" if code == 303 else "Forbidden")
        self.connection.write_headers(line, headers, body)
        self.connection.finish()

    def on_connection_close(self) -> None:
        if self.inner:
            self.inner.on_connection_close()


class _Secured:
    """Connection that adds the security headers to each answer."""

    def __init__(self, guard: Guard, connection: HTTPConnection):
        self._guard = guard
        self._connection = connection

    def write_headers(self, start_line: Any, headers: HTTPHeaders, chunk: bytes | None = None) -> Any:
        self._guard.secure(headers)
        return self._connection.write_headers(start_line, headers, chunk)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)
