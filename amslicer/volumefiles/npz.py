"""NumPy's archives of arrays: a zip of npy files."""

from __future__ import annotations

import zipfile
from typing import TYPE_CHECKING, cast

from amslicer.fields.source import MAX_FILE_BYTES
from amslicer.volumefiles.npy import read_array
from amslicer.volumefiles.volume import ViewStream, Volume, choose_array, refusal

if TYPE_CHECKING:
    from typing import IO

MAX_MEMBERS = 10_000  # arrays that anybody would name
COMPRESSIONS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}  # what NumPy writes
ENCRYPTED = 1  # bit of a member's flags


def read_npz(data: memoryview, name: str, key: str | None) -> Volume:
    """One of the arrays of an npz file, unpacked up to its declared size.

    Raises:
        JobError: not an npz file, or one that cannot be used.
    """
    if bytes(data[:2]) != b"PK":
        raise refusal(name, "is not a npz file, whatever its name says")
    try:
        with zipfile.ZipFile(cast("IO[bytes]", ViewStream(data))) as archive:
            members = archive.infolist()
            names = [info.filename.removesuffix(".npy") for info in members]
            if len(members) > MAX_MEMBERS or len(set(names)) < len(names):
                raise refusal(name, f"has {len(members)} members, some of the same name, or too many")
            chosen = members[names.index(choose_array(names, key, name))]
            where = f"{name}: {chosen.filename}"
            if not chosen.filename.endswith(".npy") or chosen.flag_bits & ENCRYPTED:
                raise refusal(where, "is not a plain array", "save it again with numpy.savez_compressed")
            if chosen.compress_type not in COMPRESSIONS:
                raise refusal(
                    where, f"is compressed by method {chosen.compress_type}", "save it with numpy.savez_compressed"
                )
            if chosen.file_size > MAX_FILE_BYTES:
                raise refusal(
                    where,
                    f"unpacks to {chosen.file_size} bytes; at most {MAX_FILE_BYTES} are read",
                    "make it smaller: fields are interpolated between samples",
                )
            with archive.open(chosen) as stream:
                content = stream.read(chosen.file_size)
    except (zipfile.BadZipFile, EOFError, NotImplementedError, OSError, RuntimeError, ValueError) as error:
        raise refusal(name, f"is a damaged npz file: {str(error) or type(error).__name__}", "save it again") from error
    return Volume(read_array(memoryview(content), where))
