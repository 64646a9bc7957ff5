"""One seed per run, and a named random stream for each consumer."""

import zlib

import numpy as np


def stream(seed: int, name: str) -> np.random.Generator:
    """Generator of its own for `name`: adding a use never shifts the numbers of another."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(name.encode())]))
