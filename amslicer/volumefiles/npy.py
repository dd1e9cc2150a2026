"""NumPy's array files: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html."""

from __future__ import annotations

import io
import struct
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib import format as npy_format

from amslicer.volumefiles.volume import Volume, check_data, check_shape, check_type, no_key, refusal

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAGIC = b"\x93NUMPY"
MAX_HEADER_BYTES = 1 << 16  # NumPy writes 128; records of hundreds of fields, which are refused, a few thousand
# Bytes of the header's own length by the format's version; 3 differs from 2 only in the names of records.
LENGTH_BYTES = {1: 2, 2: 4, 3: 4}


def read_npy(data: memoryview, name: str, key: str | None) -> Volume:
    """The array of an npy file, a view of it; of one in Fortran's order a copy.

    Raises:
        JobError: not an npy file, or one that cannot be used.
    """
    no_key(key, name)
    return Volume(read_array(data, name))


def read_array(data: memoryview, name: str) -> NDArray[Any]:
    """(z, y, x) or (z, y, x, C), C order."""
    if bytes(data[:6]) != MAGIC:
        raise refusal(name, "is not a npy file, whatever its name says")
    version = int(data[6]) if len(data) > 6 else 0
    if version not in LENGTH_BYTES:
        raise refusal(name, f"is a npy file of version {version}; 1 to 3 are read")
    count = LENGTH_BYTES[version]
    start = 8 + count
    length = int.from_bytes(data[8:start], "little")
    if len(data) < start or length > min(MAX_HEADER_BYTES, len(data) - start):
        raise refusal(
            name, f"has a header of {length} bytes in a file of {len(data)}; at most {MAX_HEADER_BYTES} are read"
        )
    header = struct.pack("<I", length) + bytes(data[start : start + length])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of headers that Python 2 wrote
            shape, fortran, dtype = npy_format.read_array_header_2_0(
                io.BytesIO(header), max_header_size=MAX_HEADER_BYTES
            )
    except Exception as error:  # NumPy raises many kinds for damaged headers
        raise refusal(name, f"has a damaged header: {str(error).splitlines()[0][:200]}") from error
    check_type(dtype, name)
    size = check_shape(shape, dtype.itemsize, name)
    start += length
    check_data(size, len(data) - start, name, exact=True)
    flat = np.frombuffer(data, dtype, count=size // dtype.itemsize, offset=start)
    # In the order of the file a layer would be gathered from everywhere.
    return np.ascontiguousarray(flat.reshape(shape[::-1]).T) if fortran else flat.reshape(shape)
