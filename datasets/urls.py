"""Files and folders by URL, through fsspec: local paths, `memory://`, `s3://` and others."""

from __future__ import annotations

from typing import Any

from turtlebag.datasets.errors import InputError


def filesystem(url: str) -> tuple[Any, str]:
    """The file system and path of a URL; InputError if a package is missing to reach it.

    Nothing is remembered of what a folder holds: others write there too.
    """
    from fsspec.core import url_to_fs

    try:
        files, path = url_to_fs(url, use_listings_cache=False)
    except ImportError as error:
        extra = "pip install 'turtlebag[s3]'" if url.startswith("s3") else f"{' '.join(str(error).split())}"
        raise InputError(f"{url}: a package is missing to read it: {extra}") from None
    except ValueError as error:
        raise InputError(f"{url}: {' '.join(str(error).split())}") from None
    return files, str(path).rstrip("/")


def is_local(files: Any) -> bool:
    """Whether a file system is that of this machine."""
    return "file" in files.protocol


def reason_of(error: Exception) -> str:
    """A file system's error in one line."""
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(said.split()) or type(error).__name__
