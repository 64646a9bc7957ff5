"""Who is let in: pages and sockets with the token, the host and the origin that are ours, and no others."""

import os
import socket

import numpy as np
import pytest
from tornado.httpclient import AsyncHTTPClient, HTTPClientError
from tornado.iostream import IOStream

from tests.studio.fakes import FakeSession, Served, connect, run
from turtlebag.pipeline.studio.access import Access, is_loopback


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A server whose page is in a folder of the test's, beside a secret."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "static/parts").mkdir(parents=True)
    (folder / "static/index.html").write_text("<!doctype html><title>page</title>")
    (folder / "static/parts/main.js").write_text("export {};")
    (folder / "secret.js").write_text("secret")
    (folder / "static/link.js").symlink_to(folder / "secret.js")
    (folder / "static/notes.txt").write_text("not a part of the page")
    session = FakeSession(cells=np.zeros((64, 64), dtype=np.int8))
    with Served(session, page=folder / "static") as running:
        yield running
    assert running.failure is None


async def fetch(url, **headers):
    return await AsyncHTTPClient().fetch(url, headers=headers, raise_error=False, follow_redirects=False)


def test_the_page_comes_with_the_token_and_headers_that_keep_others_out(served):
    async def look():
        page = await fetch(served.url)
        assert (page.code, page.body) == (200, b"<!doctype html><title>page</title>")
        policy = page.headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert f"connect-src 'self' ws://127.0.0.1:{served.access.port};" in policy
        assert page.headers["X-Content-Type-Options"] == "nosniff"
        assert page.headers["Cache-Control"] == "no-store"
        assert page.headers["Referrer-Policy"] == "no-referrer"
        assert page.headers["X-Frame-Options"] == "DENY"
        assert "Server" not in page.headers
        same = await fetch(served.url.replace("/?", "/index.html?"))
        assert (same.code, same.body) == (page.code, page.body)
        part = await fetch(f"{served.place}/parts/main.js")
        assert (part.code, part.headers["Content-Type"]) == (200, "text/javascript; charset=utf-8")
        assert part.headers["X-Content-Type-Options"] == "nosniff"

    run(look())


@pytest.mark.parametrize(
    "query", ["", "?token=", "?token=wrong", "?token=%00%ff", "?token={}x", "?token={}&token=x"]
)
def test_without_the_token_there_is_neither_page_nor_socket(served, query, caplog):
    async def attempt():
        query_ = query.format(served.access.token)
        for name in ("", "index.html", "index%2Ehtml", "%69ndex.html"):
            page = await fetch(f"{served.place}/{name}{query_}")
            assert page.code in (400, 403)
            assert served.access.token.encode() not in page.body
        with pytest.raises(HTTPClientError, match=r"40[03]"):
            await connect(f"{served.place}/{query_}")

    run(attempt())
    assert caplog.text == ""  # nobody can fill the terminal


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:{}", "127.0.0.1", "127.0.0.1:1", "127.0.0.1.evil.example:{}", "", "[::1]"],
)
def test_a_name_that_was_made_to_point_here_is_no_host(served, host):
    async def attempt():
        name = host.format(served.access.port)
        for place in (served.url, f"{served.place}/parts/main.js", f"{served.place}/nothing"):
            assert (await fetch(place, Host=name)).code in (400, 403)
        with pytest.raises(HTTPClientError, match=r"40[03]"):
            await connect(served.url, Host=name)

    run(attempt())


@pytest.mark.parametrize("host", ["localhost:{}", "LOCALHOST:{}", "[::1]:{}", "127.0.0.1:{}"])
def test_this_machine_has_several_names(served, host):
    assert run(fetch(served.url, Host=host.format(served.access.port))).code == 200


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{}", "http://127.0.0.1:1", ""]
)
def test_another_page_s_script_has_another_origin(served, origin):
    async def attempt():
        name = origin.format(served.access.port)
        assert (await fetch(served.url, Origin=name)).code == 403
        with pytest.raises(HTTPClientError, match="403"):
            await connect(served.url, Origin=name)

    run(attempt())


def test_our_own_page_has_ours(served):
    async def attempt():
        assert (await fetch(served.url, Origin=served.place)).code == 200
        client = await connect(served.url, Origin=served.place)
        await client.until(lambda p: p.head)

    run(attempt())


PATHS = (
    "/../secret.js", "/..%2fsecret.js", "/%2e%2e/secret.js", "/parts/../../secret.js", "/link.js",
    "//secret.js", "/parts/..%2f..%2fsecret.js", "/..%5csecret.js", "/%2fetc%2fpasswd", "/parts", "/parts/",
    "/notes.txt", "/parts/main.js%00.css", "/./parts/main.js", "/index.html/../../secret.js",
    "/" + "a" * 4000,
)  # fmt: skip


@pytest.mark.parametrize("path", PATHS)
def test_no_path_leaves_the_page_s_folder(served, path):
    """Sent as it stands: a client of ours would tidy it up first."""

    async def ask():
        stream = IOStream(socket.socket())
        await stream.connect(("127.0.0.1", served.access.port))
        host = f"127.0.0.1:{served.access.port}"
        await stream.write(f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
        return await stream.read_until_close()

    answer = run(ask())
    assert answer.startswith((b"HTTP/1.1 404", b"HTTP/1.1 400"))
    assert b"secret" not in answer.partition(b"\r\n\r\n")[2]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_there_is_nothing_to_be_sent_but_by_the_socket(served, method):
    async def attempt():
        client = AsyncHTTPClient()
        body = b"x" if method in ("POST", "PUT") else None
        answer = await client.fetch(served.url, method=method, body=body, raise_error=False)
        assert answer.code in (400, 403, 405)
        assert "Access-Control-Allow-Origin" not in answer.headers

    run(attempt())


def test_hosts_that_are_listened_at():
    some = Access("t", "192.168.1.5", 8000)
    assert some.is_ours("192.168.1.5:8000")
    assert not some.is_ours("192.168.1.6:8000")
    assert some.url == "http://192.168.1.5:8000/?token=t"
    every = Access("t", "0.0.0.0", 8000)
    assert every.is_ours("192.168.1.5:8000")
    assert every.is_ours("[fe80::1]:8000")
    assert every.is_ours(f"{socket.gethostname()}:8000")
    assert not every.is_ours("evil.example:8000")
    assert every.url == "http://127.0.0.1:8000/?token=t"
    assert Access("t", "::1", 8000).url == "http://[::1]:8000/?token=t"
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "10.0.0.1", "pi")] == [
        True, True, True, False, False, False,
    ]  # fmt: skip


def test_a_token_is_long_and_new(served):
    assert len(served.access.token) >= 43
    assert os.path.basename(served.url) == f"?token={served.access.token}"
