"""A minimal client of the studio: uses the socket as the page does."""

from __future__ import annotations

import asyncio
import json
import struct
import time
import zlib
from collections.abc import Callable
from typing import Any, Self
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray
from tornado.httpclient import HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

Header = dict[str, Any]
BLANK = {"map": 255, "costmap": 0}


def decoded(message: bytes) -> tuple[Header, dict[str, NDArray]]:
    """Header and blobs of a binary message."""
    (length,) = struct.unpack_from("<I", message)
    header = json.loads(message[4 : 4 + length])
    first = 4 + length + -length % 4
    blobs = {}
    for blob in header["blobs"]:
        at, dtype, count = first + blob["at"], np.dtype(f"<{blob['dtype']}"), int(np.prod(blob["shape"]))
        if blob.get("zip"):
            data = zlib.decompress(message[at : at + blob["size"]], wbits=-zlib.MAX_WBITS)
        else:
            data = message[at : at + count * dtype.itemsize]
        blobs[blob["name"]] = np.frombuffer(data, dtype=dtype, count=count).reshape(blob["shape"])
    return header, blobs


class Picture:
    """The client's state: the last header, arrays by name, grids assembled from tiles."""

    def __init__(self) -> None:
        self.hello: Header = {}
        self.head: Header = {}
        self.arrays: dict[str, NDArray] = {}
        self.grids: dict[str, NDArray] = {}
        self.places: dict[str, Header] = {}
        self.events: list[list] = []
        self.errors: list[str] = []
        self.waypoints: list[list] = []
        self.bye: str | None = None

    def take(self, message: bytes) -> None:
        """Update it with one message."""
        header, blobs = decoded(message)
        if header["kind"] == "bye":
            self.bye = header["reason"]
        elif header["kind"] == "hello":
            self.hello, self.arrays = header, dict(blobs)
        else:
            self._frame(header, blobs)

    def _frame(self, header: Header, blobs: dict[str, NDArray]) -> None:
        self.head = header
        self.events += header["events"]
        self.waypoints = header.get("waypoints", self.waypoints)
        self.errors += [header["error"]] if header.get("error") else []
        for name, grid in header.get("grids", {}).items():
            if self.places.get(name, {}).get("version") != grid["version"]:
                self.grids[name] = np.full((grid["h"], grid["w"]), BLANK[name], dtype=np.uint8)
            self.places[name], cells, at = grid, blobs.pop(f"{name}_tiles"), 0
            for x, y, w, h in grid["tiles"]:
                self.grids[name][y : y + h, x : x + w] = cells[at : at + w * h].reshape(h, w)
                at += w * h
            assert at == cells.size
        for name, values in blobs.items():
            kept = header.get("append", {}).get(name, 0)
            self.arrays[name] = np.concatenate([self.arrays[name][:kept], values]) if kept else values


class Client:
    """One socket. `await client.until(...)` reads messages.

    When each had been taken in [s, monotonic], and its bytes: `arrivals`, `sizes`.
    """

    def __init__(self, connection: WebSocketClientConnection) -> None:
        self._connection = connection
        self.picture = Picture()
        self.arrivals: list[float] = []
        self.sizes: list[int] = []

    @classmethod
    async def open(cls, url: str, **headers: str) -> Self:
        """Connect to the socket behind the page of that address; HTTPClientError when it is refused."""
        page = urlsplit(url)
        request = HTTPRequest(f"ws://{page.netloc}/socket?{page.query}", headers=headers)
        return cls(await websocket_connect(request, max_message_size=1 << 28))

    async def next(self, timeout_s: float = 20.0) -> bool:
        """Take one message; False when the connection is closed."""
        message = await asyncio.wait_for(self._connection.read_message(), timeout_s)
        if message is None:
            return False
        assert isinstance(message, bytes)
        self.sizes.append(len(message))
        self.picture.take(message)
        self.arrivals.append(time.monotonic())
        return True

    async def until(self, true: Callable[[Picture], object], timeout_s: float = 20.0) -> Picture:
        """Read until a condition holds; TimeoutError if it never does, EOFError when closed."""
        end = time.monotonic() + timeout_s
        while not true(self.picture):
            if not await self.next(max(end - time.monotonic(), 0.0)):
                raise EOFError(f"closed: {self.picture.bye}")
        return self.picture

    async def read_for(self, seconds: float) -> None:
        """Receive for some time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            try:
                if not await self.next(left):
                    return
            except TimeoutError:
                return

    def ask(self, do: str, **fields: Any) -> None:
        """Send one message as the page does."""
        self.send(json.dumps({"do": do, **fields}))

    def send(self, message: str | bytes) -> None:
        """Send anything."""
        self._connection.write_message(message, binary=isinstance(message, bytes))

    async def asked(self, do: str, **fields: Any) -> None:
        """Send one message and wait until it is accepted or refused: an AssertionError gives the reason.

        What is told of it comes with a frame that was made afterwards: the second one at the latest.
        """
        before = len(self.picture.errors)
        self.ask(do, **fields)
        for _ in range(3):
            assert await self.next(), self.picture.bye
        assert self.picture.errors[before:] == [], self.picture.errors[before:]

    @property
    def code(self) -> int | None:
        """Why the server closed."""
        return self._connection.close_code

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()
