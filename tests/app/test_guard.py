"""Who is refused: wrong Host, foreign Origin, no token, over HTTP and over a websocket. Spoken byte by byte."""

import http.client
import re
import signal
import socket
import struct
import time

import pytest

from tests.app.conftest import running


def answer(app, path="/", method="GET", host=None, **headers):
    """(status, headers, text) of one request; names of headers with _ for -."""
    connection = http.client.HTTPConnection("127.0.0.1", app.port, timeout=20)
    try:
        connection.putrequest(method, path, skip_host=True)
        if host != "":
            connection.putheader("Host", host or f"127.0.0.1:{app.port}")
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        response = connection.getresponse()
        return response.status, response.headers, response.read().decode()
    finally:
        connection.close()


@pytest.fixture(scope="module")
def cookie(app):
    status, headers, _ = answer(app, f"/?token={app.token}")
    assert status == 303
    return headers["Set-Cookie"].split(";")[0]


def websocket(app, page, **headers):
    token = re.search(r'"token":\s*"([^"]+)"', page)[1]
    return answer(
        app, "/ws", Upgrade="websocket", Connection="Upgrade", Sec_WebSocket_Version="13",
        Sec_WebSocket_Key="dGhlIHNhbXBsZSBub25jZQ==", Sec_WebSocket_Protocol=f"bokeh, {token}", **headers,
    )  # fmt: skip


def test_the_token_leaves_the_address(app, cookie):
    status, headers, _ = answer(app, f"/?token={app.token}")
    assert (status, headers["Location"]) == (303, "/")
    assert "HttpOnly" in headers["Set-Cookie"]
    assert "SameSite=Strict" in headers["Set-Cookie"]
    assert app.token not in headers["Set-Cookie"]
    status, headers, page = answer(app, Cookie=cookie)
    assert status == 200
    assert app.token not in page
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize("path", ["/", "/?token=wrong", "/static/js/bokeh.min.js", "/ws", "/autoload.js", "/save/x"])
def test_nothing_without_the_token(app, path):
    status, _, text = answer(app, path)
    assert status == 403
    assert text.startswith("refused: ")
    assert text.count("\n") == 1


@pytest.mark.parametrize("request_", ["GET / HTTP/1.1\r\n\r\n", "POST / HTTP/1.1\r\nContent-Length: 1000000\r\n\r\n"])
def test_a_refused_connection_is_closed(app, request_):
    """Though it asks to be kept, and before its body has come."""
    request_ = request_.replace("\r\n\r\n", f"\r\nHost: 127.0.0.1:{app.port}\r\nConnection: keep-alive\r\n\r\n")
    with socket.create_connection(("127.0.0.1", app.port), timeout=20) as connection:
        connection.sendall(request_.encode())
        received = b"".join(iter(lambda: connection.recv(65536), b""))
    assert received.startswith(b"HTTP/1.1 403")
    assert b"refused: the token is missing" in received


def test_a_wrong_cookie_is_none(app, cookie):
    assert answer(app, Cookie=cookie[:-1] + ("a" if cookie[-1] != "a" else "b"))[0] == 403
    assert answer(app, Cookie=f"{cookie.split('=')[0]}={app.token}")[0] == 403


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "", "127.0.0.1.evil.example:{port}"]
)
def test_a_foreign_host_is_refused(app, cookie, host):
    assert answer(app, host=host.format(port=app.port), Cookie=cookie)[0] in (400, 403)
    assert answer(app, f"/?token={app.token}", host=host.format(port=app.port))[0] in (400, 403)


def test_localhost_is_this_machine(app, cookie):
    assert answer(app, host=f"localhost:{app.port}", Cookie=cookie)[0] == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1"])
def test_a_foreign_origin_is_refused(app, cookie, origin):
    origin = origin.format(port=app.port)
    assert answer(app, Cookie=cookie, Origin=origin)[0] == 403
    page = answer(app, Cookie=cookie)[2]
    assert websocket(app, page, Cookie=cookie, Origin=origin)[0] == 403


def test_a_websocket_needs_origin_and_token(app, cookie):
    own = f"http://127.0.0.1:{app.port}"
    page = answer(app, Cookie=cookie)[2]
    assert websocket(app, page, Cookie=cookie)[0] == 403
    assert websocket(app, page, Origin=own)[0] == 403
    assert answer(app, Cookie=cookie, Origin=own)[0] == 200


def test_only_the_loopback_is_listened_on(app):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # sends nothing
        try:
            probe.connect(("192.0.2.1", 9))
            outer = probe.getsockname()[0]
        except OSError:
            pytest.skip("this machine has no other address")
    if outer.startswith("127."):
        pytest.skip("this machine has no other address")
    with pytest.raises(OSError), socket.create_connection((outer, app.port), timeout=2):
        pass


def test_resets_rubbish_and_ctrl_c_leave_no_traceback():
    with running() as app:
        cookie = answer(app, f"/?token={app.token}")[1]["Set-Cookie"].split(";")[0]
        page = answer(app, Cookie=cookie)[2]
        token = re.search(r'"token":\s*"([^"]+)"', page)[1]
        for rubbish in (b"", b"GET / HTTP/1.1\r\n", b"\x16\x03\x01" * 50, b"GET / HTTP/1.1\r\nHost: " + b"a" * 99999):
            reset(app, rubbish)
        head = (
            f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{app.port}\r\nOrigin: http://127.0.0.1:{app.port}\r\nCookie: {cookie}\r\n"
            "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: bokeh, {token}\r\n\r\n"
        ).encode()
        reset(app, head)  # a websocket that opens and is reset
        reset(app, head + b"\x81\x05hello")  # and one that speaks no protocol
        reset(app, f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{app.port}\r\nCookie: {cookie}\r\n\r\n".encode(), wait=0)
        assert answer(app, Cookie=cookie)[0] == 200
        assert app.end(signal.SIGINT) == 130
        assert "".join(app.errors) == "matcam: interrupted; no incomplete file was left\n"


def reset(app, request, wait=0.3):
    """Send bytes and reset the connection."""
    with socket.create_connection(("127.0.0.1", app.port), timeout=10) as one:
        one.sendall(request)
        time.sleep(wait)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def test_another_host_must_be_asked_for_and_is_explained():
    with running("--host", "0.0.0.0") as app:
        time.sleep(0.5)
        assert "anyone who has the address below and can reach this machine" in "".join(app.errors)
        cookie = answer(app, f"/?token={app.token}")[1]["Set-Cookie"].split(";")[0]
        assert answer(app, host=f"192.0.2.7:{app.port}", Cookie=cookie)[0] == 200
        assert answer(app, host=f"evil.example:{app.port}", Cookie=cookie)[0] == 403
