"""Places that cannot be written to, or not for long."""

import ctypes
import resource
import struct
import subprocess
from contextlib import contextmanager

import pytest


@contextmanager
def files_below(size):
    """No file may grow to `size` bytes; as on a full disk, writing more is an error."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size - 1, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def mounted(place, options):
    """A small file system at a folder."""
    mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no tmpfs can be mounted here")
    try:
        yield
    finally:
        # Lazily: a traceback that is not collected yet may hold a file of it open.
        subprocess.run(["umount", "--lazy", str(place)], check=True)


@contextmanager
def ordinary_user():
    """This thread may not write where it is not allowed to, root or not (Linux's capget and capset)."""
    libc, header = ctypes.CDLL(None, use_errno=True), struct.pack("=Ii", 0x20080522, 0)
    usual = ctypes.create_string_buffer(24)  # twice what is effective, permitted, inheritable
    libc.capget(header, usual)
    assert libc.capset(header, bytes(4) + usual.raw[4:12] + bytes(4) + usual.raw[16:]) == 0
    try:
        yield
    finally:
        assert libc.capset(header, usual.raw) == 0
