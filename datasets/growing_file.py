"""A file that ends with a whole record, whatever happens while it grows."""

from __future__ import annotations

import os
from pathlib import Path


class GrowingFile:
    """Bytes are held until `flush`; where they have no room the file is cut to what it was before."""

    def __init__(self, path: Path) -> None:
        """FileExistsError when there is such a file."""
        self._file = path.open("xb", buffering=0)
        self._held = bytearray()
        self.size = 0
        """Bytes in the file."""

    def write(self, data: bytes) -> int:
        """Take bytes."""
        self._held += data
        return len(data)

    def tell(self) -> int:
        """Where the next byte goes."""
        return self.size + len(self._held)

    def flush(self) -> None:
        """Hand what is held to the operating system; OSError when it has no room."""
        left = memoryview(bytes(self._held))
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            os.ftruncate(self._file.fileno(), self.size)
            self._file.seek(self.size)
            raise
        self.size = self.tell()
        self._held.clear()

    def close(self) -> None:
        """Close the file, without what is held."""
        self._file.close()
