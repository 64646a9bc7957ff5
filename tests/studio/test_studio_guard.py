"""Those who do not mean well: other programs, other pages, noise, and clients that never read."""

import asyncio
import os
import socket
import time
from collections import Counter

import numpy as np
import pytest
from studio_fakes import FakeSession, Served, connect, run
from tornado.httpclient import AsyncHTTPClient, HTTPClientError
from tornado.iostream import IOStream

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.studio import frames as frames_module
from turtlebag.pipeline.studio import server
from turtlebag.pipeline.studio.guard import Guard, Rate, is_loopback, listen


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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(server, "PAGE", folder / "static")
        with Served(FakeSession(cells=np.zeros((64, 64), dtype=np.int8))) as running:
            yield running
    assert running.failure is None


async def fetch(url, **headers):
    return await AsyncHTTPClient().fetch(url, headers=headers, raise_error=False, follow_redirects=False)


def answers(served):
    """Whether the server still does what it is for."""

    async def watch():
        client = await connect(served.url)
        await client.until(lambda p: p.head)
        client.close()

    run(watch())
    return True


def test_the_page_comes_with_the_token_and_headers_that_keep_others_out(served):
    async def look():
        page = await fetch(served.url)
        assert (page.code, page.body) == (200, b"<!doctype html><title>page</title>")
        policy = page.headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert f"connect-src 'self' ws://127.0.0.1:{served.guard.port};" in policy
        assert page.headers["X-Content-Type-Options"] == "nosniff"
        assert page.headers["Cache-Control"] == "no-store"
        assert page.headers["Referrer-Policy"] == "no-referrer"
        assert page.headers["X-Frame-Options"] == "DENY"
        assert "Server" not in page.headers
        part = await fetch(f"{served.place}/parts/main.js")
        assert (part.code, part.headers["Content-Type"]) == (200, "text/javascript; charset=utf-8")
        assert part.headers["X-Content-Type-Options"] == "nosniff"

    run(look())


@pytest.mark.parametrize(
    "query", ["", "?token=", "?token=wrong", "?token=%00%ff", "?token={}x", "?token={}&token=x"]
)
def test_without_the_token_there_is_neither_page_nor_socket(served, query, caplog):
    async def attempt():
        query_ = query.format(served.guard.token)
        page = await fetch(f"{served.place}/{query_}")
        assert page.code in (400, 403)
        assert served.guard.token.encode() not in page.body
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
        name = host.format(served.guard.port)
        for place in (served.url, f"{served.place}/parts/main.js", f"{served.place}/nothing"):
            assert (await fetch(place, Host=name)).code in (400, 403)
        with pytest.raises(HTTPClientError, match=r"40[03]"):
            await connect(served.url, Host=name)

    run(attempt())


@pytest.mark.parametrize("host", ["localhost:{}", "LOCALHOST:{}", "[::1]:{}", "127.0.0.1:{}"])
def test_this_machine_has_several_names(served, host):
    assert run(fetch(served.url, Host=host.format(served.guard.port))).code == 200


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{}", "http://127.0.0.1:1", ""]
)
def test_another_page_s_script_has_another_origin(served, origin):
    async def attempt():
        name = origin.format(served.guard.port)
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
        await stream.connect(("127.0.0.1", served.guard.port))
        host = f"127.0.0.1:{served.guard.port}"
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


MALFORMED = (
    "", "x", "[]", "null", '"drive"', "{}", '{"do": 1}', '{"do": "shutdown"}', '{"do": ["drive"]}',
    "[" * 60_000, '{"do": "drive", "v": ' + "9" * 5000 + "}", "\0", b"\x00\x01", b"{}",
    '{"do": "stop"}' + " " * 65_536,
)  # fmt: skip


@pytest.mark.parametrize("message", MALFORMED, ids=range(len(MALFORMED)))
def test_a_message_that_no_page_sends_ends_the_socket_with_a_reason(served, message):
    async def attempt():
        client = await connect(served.url)
        await client.until(lambda p: p.head)
        client.send(message)
        with pytest.raises(EOFError, match=r"a message|messages are"):
            await client.until(lambda p: False)
        assert client.code == 1008

    run(attempt())
    assert answers(served)


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ('{"do": "drive", "v": NaN, "w": 0}', "drive: v"),
        ('{"do": "drive", "v": 1e999, "w": 0}', "drive: v"),
        ('{"do": "drive", "x": 1}', "unknown key"),
        ('{"do": "map_save", "name": "../../etc/passwd"}', "name"),
        ('{"do": "record", "name": "a/b"}', "name"),
        ('{"do": "goal", "pose": [1]}', "pose"),
        ('{"do": "speed", "factor": -1}', "speed"),
        ('{"do": "layers", "layers": ' + str(["x"] * 100).replace("'", '"') + "}", "layers"),
    ],
)
def test_values_that_make_no_sense_are_refused_in_one_line(served, message, said):
    async def attempt():
        client = await connect(served.url)
        await client.until(lambda p: p.head)
        client.send(message)
        await client.read_for(0.4)
        client.close()
        return client.picture.errors

    errors = run(attempt())
    assert all("\n" not in error and len(error) < 300 for error in errors)
    assert said in errors[0]


@pytest.mark.slow
def test_a_giant_message_is_not_even_read(served):
    async def attempt():
        client = await connect(served.url)
        await client.until(lambda p: p.head)
        client.send("x" * 50_000_000)
        while await client.next():
            pass

    run(attempt())
    assert answers(served)


def test_more_messages_than_a_person_sends_end_the_socket(served):
    async def attempt():
        client = await connect(served.url)
        await client.until(lambda p: p.head)
        for _ in range(200):
            client.ask("stop")
        with pytest.raises(EOFError, match="at most 60 messages a second"):
            await client.until(lambda p: False)

    before = len(served.session.applied)
    run(attempt())
    assert len(served.session.applied) - before <= 60


@pytest.mark.slow
def test_random_bytes_end_the_connection_they_come_by(served):
    async def attempt(seed, opened):
        noise = np.random.default_rng(seed).bytes(20_000)
        stream = IOStream(socket.socket())
        await stream.connect(("127.0.0.1", served.guard.port))
        if opened:
            await stream.write(
                f"GET /socket?token={served.guard.token} HTTP/1.1\r\nHost: 127.0.0.1:{served.guard.port}\r\n"
                "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
            )
            await stream.read_until(b"\r\n\r\n")
        await stream.write(noise + b"\r\n\r\n")
        await asyncio.wait_for(stream.read_until_close(), 10.0)

    for seed in range(10):
        run(attempt(seed, opened=seed % 2 == 0))
    assert answers(served)


@pytest.mark.slow
def test_two_hundred_connections_and_sixteen_of_them_watch(served):
    async def crowd():
        idle = []
        for _ in range(200):
            stream = IOStream(socket.socket())
            await stream.connect(("127.0.0.1", served.guard.port))
            idle.append(stream)
        clients = await asyncio.gather(*(connect(served.url) for _ in range(200)))

        async def watch(client):
            while client.picture.bye is None and not client.picture.head:
                await client.next()
            return client.picture.bye

        said = await asyncio.gather(*map(watch, clients))
        assert Counter(said) == {None: 16, "16 pages are open already: close one": 184}
        for client in clients:
            client.close()
        for stream in idle:
            stream.close()

    run(crowd())
    time.sleep(0.5)
    assert answers(served)


def deaf(served):
    """A socket that is opened and then never read."""
    one = socket.create_connection(("127.0.0.1", served.guard.port))
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    one.sendall(
        f"GET /socket?token={served.guard.token} HTTP/1.1\r\nHost: 127.0.0.1:{served.guard.port}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    return one


@pytest.mark.slow
def test_clients_that_never_read_cost_nobody_else_a_frame(monkeypatch, caplog):
    """Each frame is a new map of noise, so that what the system keeps for the deaf is soon full."""
    rng, frames = np.random.default_rng(0), []
    session = FakeSession()
    inner = session.view

    def noisy():
        from turtlebag.datasets.grid import OccupancyGrid
        from turtlebag.pipeline.studio.view import MapLayer

        session._map = MapLayer(OccupancyGrid(rng.integers(0, 101, (400, 400)).astype(np.int8), 0.05))
        return inner()

    session.view = noisy
    monkeypatch.setattr(frames_module, "GRID_BYTES_A_SECOND", 1e9)
    encode = server.Frames.frame
    monkeypatch.setattr(server.Frames, "frame", lambda self, *a: frames.append(id(self)) or encode(self, *a))

    async def watch():
        client = await connect(served.url)
        await client.read_for(3.0)
        return client

    with Served(session) as served:
        silent = [deaf(served) for _ in range(5)]
        time.sleep(1.0)
        before = len(frames)
        client = run(watch())
        gaps = np.diff(client.arrivals[1:])
        assert np.median(gaps) < 0.13
        assert gaps.max() < 0.5
        # In those three seconds the deaf were not even written for: nothing piles up.
        assert len(frames) - before < 1.2 * gaps.size + 10
        assert 0.8 < client.picture.head["factor"] < 1.2
        begun = time.monotonic()
        served.stop()
        assert time.monotonic() - begun < 3.0
    for one in silent:
        one.close()
    assert served.failure is None
    assert caplog.records == []


@pytest.mark.slow
def test_who_does_not_answer_pings_is_gone(monkeypatch):
    monkeypatch.setattr(server, "PING_S", 0.3)

    async def come_and_see():
        client = await connect(served.url)
        return (await client.until(lambda p: p.head)).head["driver"]

    with Served(FakeSession()) as served:
        one = deaf(served)
        time.sleep(0.2)
        assert not run(come_and_see())
        # Two pings, and the five seconds that a page is given to close in good order.
        time.sleep(6.0)
        assert run(come_and_see())
        one.close()


def test_hosts_that_are_listened_at():
    some = Guard("t", "192.168.1.5", 8000)
    assert some.is_ours("192.168.1.5:8000")
    assert not some.is_ours("192.168.1.6:8000")
    assert some.url == "http://192.168.1.5:8000/?token=t"
    every = Guard("t", "0.0.0.0", 8000)
    assert every.is_ours("192.168.1.5:8000")
    assert every.is_ours("[fe80::1]:8000")
    assert every.is_ours(f"{socket.gethostname()}:8000")
    assert not every.is_ours("evil.example:8000")
    assert every.url == "http://127.0.0.1:8000/?token=t"
    assert Guard("t", "::1", 8000).url == "http://[::1]:8000/?token=t"
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "10.0.0.1", "pi")] == [
        True, True, True, False, False, False,
    ]  # fmt: skip


def test_a_port_or_host_that_cannot_be_had_is_one_line():
    (taken,) = listen("127.0.0.1", 0)
    port = taken.getsockname()[1]
    with pytest.raises(InputError, match=f"^--port {port}: in use"):
        listen("127.0.0.1", port)
    taken.close()
    with pytest.raises(InputError, match=r"^--host 192\.0\.2\.1: .*; give an address of this machine$"):
        listen("192.0.2.1", 0)
    with pytest.raises(InputError, match=r"^--host no such host"):
        listen("no such host", 0)


def test_a_rate_is_of_any_second():
    now = [0.0]
    rate = Rate(3, lambda: now[0])
    assert [rate.exceeded() for _ in range(4)] == [False, False, False, True]
    now[0] = 1.0
    assert [rate.exceeded() for _ in range(4)] == [False, False, False, True]


def test_a_token_is_long_and_new(served):
    assert len(served.guard.token) >= 43
    assert os.path.basename(served.url) == f"?token={served.guard.token}"
