"""The user's cache folder: what can be had again, only slower. Never needed, never trusted, never fatal."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path

DIGEST_BYTES = hashlib.sha256().digest_size


def cache_folder() -> Path:
    """A folder of this version's own below the user's cache folder (it may not exist)."""
    import platformdirs

    from amslicer import __version__

    return Path(platformdirs.user_cache_dir("amslicer")) / __version__


def read_cached(name: str) -> bytes | None:
    """What was kept under this name, or None."""
    try:
        kept = (cache_folder() / name).read_bytes()
    except OSError:
        return None
    # A torn or altered file could end the process that hands it to a driver.
    digest, content = kept[:DIGEST_BYTES], kept[DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else None


def write_cached(name: str, content: bytes) -> None:
    """Keeps something, if the folder can be written to; two processes may do so at once."""
    file = cache_folder() / name
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary = file.with_name(f"{file.name}.{os.getpid()}.tmp")
        temporary.write_bytes(hashlib.sha256(content).digest() + content)
        temporary.replace(file)
