"""Too many clients, and clients that never read or answer."""

import asyncio
import socket
import time
from collections import Counter

import numpy as np
import pytest
from tornado.ioloop import IOLoop
from tornado.iostream import IOStream

from tests.studio.fakes import FakeSession, Served, answers, connect, run
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.pipeline.studio import server
from turtlebag.pipeline.studio import socket_messages as frames_module
from turtlebag.pipeline.studio.view import MapLayer


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
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    one.sendall(
        f"GET /socket?token={serving.access.token} HTTP/1.1\r\nHost: 127.0.0.1:{serving.access.port}\r\n"
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
        session._map = MapLayer(OccupancyGrid(rng.integers(0, 101, (400, 400)).astype(np.int8), 0.05))
        return inner()

    session.view = noisy
    monkeypatch.setattr(frames_module, "GRID_BYTES_A_SECOND", 1e9)
    monkeypatch.setattr(server, "CLOSING_S", 0.2)
    encode = server.Frames.frame
    monkeypatch.setattr(server.Frames, "frame", lambda self, *a: frames.append(id(self)) or encode(self, *a))

    async def watch():
        client = await connect(serving.url)
        await client.read_for(1.5)
        return client

    with Served(session) as serving:
        silent, before = [deaf(serving) for _ in range(5)], -1
        while len(frames) > before:  # until the system keeps no more for them
            before = len(frames)
            time.sleep(0.6)
        client = run(watch())
        gaps = np.diff(client.arrivals[1:])
        assert np.median(gaps) < 0.13
        assert gaps.max() < 0.5
        # Meanwhile the deaf were not even written for: nothing piles up.
        assert len(frames) - before < 1.2 * gaps.size + 10
        assert 0.8 < client.picture.head["factor"] < 1.2
        begun = time.monotonic()
        serving.stop()
        assert time.monotonic() - begun < 2.0
    for one in silent:
        one.close()
    assert serving.failure is None
    assert caplog.records == []


@pytest.mark.slow
def test_who_does_not_answer_pings_is_gone(monkeypatch):
    monkeypatch.setattr(server, "PING_S", 0.3)
    add_timeout = IOLoop.add_timeout

    def sooner(loop, deadline, *rest):
        """Tornado gives a page five seconds to close in good order; here it is half a second."""
        return add_timeout(loop, min(deadline, loop.time() + 0.5), *rest)

    monkeypatch.setattr(IOLoop, "add_timeout", sooner)

    async def come_and_see():
        client = await connect(serving.url)
        return (await client.until(lambda p: p.head)).head["driver"]

    with Served(FakeSession()) as serving:
        one = deaf(serving)
        time.sleep(0.2)
        assert not run(come_and_see())
        time.sleep(1.5)  # two pings, and the time to close
        assert run(come_and_see())
        one.close()
