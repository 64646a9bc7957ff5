"""Too many clients, and clients that never read or answer."""

import asyncio
import dataclasses
import socket
import time
from collections import Counter

import numpy as np
import pytest
from tornado.ioloop import IOLoop
from tornado.iostream import IOStream

from docs.examples.studio_client import decoded
from tests.studio.fakes import FakeSession, Served, answers, connect, run


@pytest.mark.slow
def test_two_hundred_connections_and_sixteen_of_them_watch(serving):
    async def crowd():
        idle = []
        for _ in range(200):
            stream = IOStream(socket.socket())
            await stream.connect(("127.0.0.1", serving.access.port))
            idle.append(stream)
        clients = await asyncio.gather(*(connect(serving.url) for _ in range(200)))

        async def watch(client):
            while client.picture.bye is None and not client.picture.head:
                await client.next()
            return client.picture.bye

        said = await asyncio.gather(*map(watch, clients))
        assert Counter(said) == {None: 16, "16 pages are already open: close one": 184}
        for client in clients:
            client.close()
        for stream in idle:
            stream.close()

    run(crowd())
    time.sleep(0.2)
    assert answers(serving)


def deaf(serving):
    """A socket that is opened and then never read."""
    one = socket.create_connection(("127.0.0.1", serving.access.port))
    one.sendall(
        f"GET /socket?token={serving.access.token} HTTP/1.1\r\nHost: 127.0.0.1:{serving.access.port}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    return one


def frames_of(one):
    """The headers of the frames that a socket which was never read gets now."""
    with one.makefile("rb") as file:
        while file.readline() != b"\r\n":
            pass
        while True:
            _, size = file.read(2)
            if size > 125:
                size = int.from_bytes(file.read(2 if size == 126 else 8))
            header, _ = decoded(file.read(size))
            if header["kind"] == "frame":
                yield header


@pytest.mark.slow
def test_clients_that_never_read_cost_nobody_else_a_frame(caplog):
    """Each frame is a large scan of noise, so that what the system keeps for the deaf is soon full."""
    rng, session = np.random.default_rng(0), FakeSession()
    inner = session.view

    def noisy():
        return dataclasses.replace(inner(), scan=rng.normal(size=(20_000, 2)))

    session.view = noisy

    async def watch():
        client = await connect(serving.url)
        await client.read_for(1.5)
        return client

    with Served(session) as serving:
        alone = run(watch())
        silent, begun = [deaf(serving) for _ in range(5)], alone.picture.head["t"]
        time.sleep(1.0)
        client = run(watch())
        assert len(client.arrivals) > 0.7 * len(alone.arrivals) > 3
        assert client.picture.head["factor"] > 0.7 * alone.picture.head["factor"]
        # Meanwhile the deaf were not written for, and nothing piled up: after old frames comes the newest.
        kept = []
        for header in frames_of(silent[0]):
            kept.append(header["t"])
            if header["t"] > client.picture.head["t"]:
                break
        assert len(kept) < 8
        assert np.diff(kept).max() > 0.5 * (client.picture.head["t"] - begun)
        begun = time.monotonic()
        serving.stop()
        assert time.monotonic() - begun < 2.0
    for one in silent:
        one.close()
    assert serving.failure is None
    assert caplog.records == []


@pytest.mark.slow
def test_who_does_not_answer_pings_is_gone(monkeypatch):
    add_timeout = IOLoop.add_timeout

    def sooner(loop, deadline, *rest):
        """Tornado gives a page five seconds to close in good order; here it is half a second."""
        return add_timeout(loop, min(deadline, loop.time() + 0.5), *rest)

    monkeypatch.setattr(IOLoop, "add_timeout", sooner)

    async def come_and_see():
        client = await connect(serving.url)
        return (await client.until(lambda p: p.head)).head["driver"]

    with Served(FakeSession(), ping_s=0.3) as serving:
        one = deaf(serving)
        time.sleep(0.2)
        assert not run(come_and_see())
        time.sleep(1.5)  # two pings, and the time to close
        assert run(come_and_see())
        one.close()
