"""Messages that no page sends: malformed, without sense, giant, too many, and noise."""

import asyncio
import socket

import numpy as np
import pytest
from tornado.iostream import IOStream

from tests.studio.fakes import answers, connect, run
from turtlebag.pipeline.studio.access import Rate

MALFORMED = (
    "", "x", "[]", "null", '"drive"', "{}", '{"do": 1}', '{"do": "shutdown"}', '{"do": ["drive"]}',
    "[" * 60_000, '{"do": "drive", "v": ' + "9" * 5000 + "}", "\0", b"\x00\x01", b"{}",
    '{"do": "stop"}' + " " * 65_536,
)  # fmt: skip


def test_messages_that_no_page_sends_end_the_socket_with_a_reason(serving):
    async def attempt(message):
        client = await connect(serving.url)
        await client.until(lambda p: p.head)
        client.send(message)
        with pytest.raises(EOFError, match=r"a message|messages (must|are)"):
            await client.until(lambda p: False)
        return client.code

    async def attempts():
        return await asyncio.gather(*map(attempt, MALFORMED))

    assert run(attempts()) == [1008] * len(MALFORMED)
    assert answers(serving)


def test_a_value_that_makes_no_sense_is_told_its_page_and_the_socket_stays(serving):
    async def attempts():
        client = await connect(serving.url)
        await client.until(lambda p: p.head)
        for count, message in enumerate(('{"do": "drive", "v": NaN}', '{"do": "speed", "factor": -1}'), 1):
            client.send(message)
            await client.until(lambda p, count=count: len(p.errors) == count)
        return client.picture.errors

    drive, speed = run(attempts())
    assert drive.startswith("page: drive: v: ")
    assert speed.startswith("speed: ")


@pytest.mark.slow
def test_a_giant_message_is_not_even_read(serving):
    async def attempt():
        client = await connect(serving.url)
        await client.until(lambda p: p.head)
        client.send("x" * 50_000_000)
        while await client.next():
            pass

    run(attempt())
    assert answers(serving)


def test_more_messages_than_a_person_sends_end_the_socket(serving):
    async def attempt():
        client = await connect(serving.url)
        await client.until(lambda p: p.head)
        for _ in range(200):
            client.ask("stop")
        with pytest.raises(EOFError, match="at most 60 messages a second"):
            await client.until(lambda p: False)

    before = len(serving.session.applied)
    run(attempt())
    assert len(serving.session.applied) - before <= 60


def test_a_rate_is_of_any_second():
    now = [0.0]
    rate = Rate(3, lambda: now[0])
    assert [rate.exceeded() for _ in range(4)] == [False, False, False, True]
    now[0] = 1.0
    assert [rate.exceeded() for _ in range(4)] == [False, False, False, True]


@pytest.mark.slow
def test_random_bytes_end_the_connection_they_come_by(serving):
    async def attempt(seed, opened):
        noise = np.random.default_rng(seed).bytes(20_000)
        stream = IOStream(socket.socket())
        await stream.connect(("127.0.0.1", serving.access.port))
        if opened:
            await stream.write(
                f"GET /socket?token={serving.access.token} HTTP/1.1\r\n"
                f"Host: 127.0.0.1:{serving.access.port}\r\n"
                "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
            )
            await stream.read_until(b"\r\n\r\n")
        await stream.write(noise + b"\r\n\r\n")
        await asyncio.wait_for(stream.read_until_close(), 10.0)

    for seed in range(10):
        run(attempt(seed, opened=seed % 2 == 0))
    assert answers(serving)
