"""Volume files: what each type holds is read as it is, and what it may not hold is refused by name."""

from __future__ import annotations

import base64
import contextlib
import gzip
import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from amslicer import JobError
from amslicer.fields import source
from amslicer.fields.source import Inputs
from amslicer.volumefiles import READERS, Volume, read_volume
from amslicer.volumefiles import volume as checks

Array = NDArray[Any]
RNG = np.random.default_rng(3)
SHAPE = (3, 4, 5)  # z, y, x: all different, so that no two axes can be mixed up
TYPES = ("u1", "u2", "u4", "u8", "f4", "f8")


def samples(kind: str = "u2", shape: tuple[int, ...] = SHAPE) -> Array:
    if kind.lstrip("<>")[0] == "f":
        return RNG.random(shape).astype(kind)
    return RNG.integers(0, 2 ** min(63, 8 * np.dtype(kind).itemsize), shape, dtype=np.uint64).astype(kind)


# Writers of each type, (z, y, x[, C]) arrays to bytes


def npy(a: Array) -> bytes:
    stream = io.BytesIO()
    np.save(stream, a)
    return stream.getvalue()


def npz(save: Callable[..., None] = np.savez_compressed, **arrays: Array) -> bytes:
    stream = io.BytesIO()
    save(stream, **arrays)
    return stream.getvalue()


def nrrd_file(a: Array, folder: Path, **header: Any) -> bytes:
    """By pynrrd, whose own order of axes is the file's when asked for C."""
    file = folder / "made.nrrd"
    nrrd.write(str(file), a, header, index_order="C")
    return file.read_bytes()


def tiff(a: Array, **settings: Any) -> bytes:
    stream = io.BytesIO()
    tifffile.imwrite(stream, a, **{"photometric": "minisblack", **settings})
    return stream.getvalue()


VTK_TYPES = {"u1": "UInt8", "u2": "UInt16", "u4": "UInt32", "u8": "UInt64", "f4": "Float32", "f8": "Float64"}
BLOCK = 64  # bytes per packed block: several blocks, and a smaller last one


def vti(
    arrays: dict[str, Array], where: str = "CellData", *, form: str = "raw", order: str = "<", header: int = 4,
    packed: bool = False, geometry: str = 'Origin="0 0 0" Spacing="1 1 1"', start: tuple[int, int, int] = (0, 0, 0),
) -> bytes:  # fmt: skip
    """As the VTK file format's description has it: ascii, base64 (inline), raw or appended (base64)."""
    word = f"{order}u{header}"

    def encode(a: Array) -> bytes:
        data = a.astype(a.dtype.newbyteorder(order)).tobytes()
        if packed:
            blocks = [data[i : i + BLOCK] for i in range(0, len(data), BLOCK)]
            small = [zlib.compress(block) for block in blocks]
            last = len(data) % BLOCK
            head = np.array([len(blocks), BLOCK, last, *map(len, small)], word).tobytes()
            body = b"".join(small)
        else:
            head, body = np.array([len(data)], word).tobytes(), data
        if form == "raw":
            return head + body
        if packed:
            return base64.b64encode(head) + base64.b64encode(body)
        return base64.b64encode(head + body)

    first = next(iter(arrays.values()))
    sides = first.shape[2::-1]
    more = 0 if where == "CellData" else 1
    extent = " ".join(f"{s} {s + n - more}" for s, n in zip(start, sides, strict=True))
    appended, lines = b"", []
    for name, a in arrays.items():
        code = VTK_TYPES.get(a.dtype.str[1:], {"i": f"Int{8 * a.itemsize}"}.get(a.dtype.kind, "String"))
        parts = f'<DataArray type="{code}" Name="{name}" NumberOfComponents="{a.shape[3] if a.ndim == 4 else 1}"'
        if form == "ascii":
            lines.append(f'{parts} format="ascii">{" ".join(map(repr, a.ravel().tolist()))}</DataArray>')
        elif form == "base64":
            lines.append(f'{parts} format="binary">\n  {encode(a).decode()}\n</DataArray>')
        else:
            lines.append(f'{parts} format="appended" offset="{len(appended)}"/>')
            appended += encode(a)
    packer = ' compressor="vtkZLibDataCompressor"' if packed else ""
    text = (
        f'<?xml version="1.0"?>\n<VTKFile type="ImageData" version="1.0" '
        f'byte_order="{"LittleEndian" if order == "<" else "BigEndian"}" header_type="UInt{8 * header}"'
        f"{packer}>\n"
        f'<ImageData WholeExtent="{extent}" {geometry}>'
        f'<Piece Extent="{extent}"><{where}>{"".join(lines)}</{where}></Piece></ImageData>\n'
    ).encode()
    if form in ("raw", "appended"):
        encoding = "raw" if form == "raw" else "base64"
        text += f'<AppendedData encoding="{encoding}">\n _'.encode() + appended + b"\n</AppendedData>"
    return text + b"\n</VTKFile>\n"


def read(content: bytes, name: str, key: str | None = None) -> Volume:
    return read_volume(memoryview(content), name, key)


def agree(found: Array, expected: Array) -> None:
    """The same numbers in the same places, of the same type but for the order of bytes."""
    assert found.dtype.newbyteorder("=") == expected.dtype.newbyteorder("=")
    np.testing.assert_array_equal(found, expected)


def test_agree_can_fail() -> None:
    a = samples()
    for other in (a.T, a[::-1], a.astype("u4"), a + 1):
        with pytest.raises(AssertionError):
            agree(a, other)


# What is there is read


@pytest.mark.parametrize("shape", [SHAPE, (*SHAPE, 3), (*SHAPE, 6), (1, 1, 1)])
@pytest.mark.parametrize("kind", [*TYPES, ">u2", ">f4", "f2", "?"])
def test_npy(kind: str, shape: tuple[int, ...]) -> None:
    a = samples(kind, shape) if kind != "?" else RNG.random(shape) > 0.5
    found = read(npy(a), "a.npy")
    agree(found.array, a)
    assert (found.spacing_mm, found.origin_mm, found.at_corners) == (None, None, False)
    assert found.channels == (None if len(shape) == 3 else shape[3])


def test_npy_in_fortran_order_has_the_same_axes() -> None:
    for shape in (SHAPE, (*SHAPE, 3)):
        a = samples("f4", shape)
        content = npy(np.asfortranarray(a))
        assert b"'fortran_order': True" in content
        agree(read(content, "a.npy").array, a)


@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
def test_npy_versions(version: tuple[int, int]) -> None:
    stream, a = io.BytesIO(), samples()
    np.lib.format.write_array(stream, a, version=version)
    agree(read(stream.getvalue(), "a.npy").array, a)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_npz(save: Callable[..., None]) -> None:
    a, b = samples("f4"), samples("u1", (*SHAPE, 3))
    agree(read(npz(save, ratio=a), "a.npz").array, a)
    both = npz(save, ratio=a, fibres=b)
    agree(read(both, "a.npz", "ratio").array, a)
    agree(read(both, "a.npz", "fibres").array, b)


@pytest.mark.parametrize("encoding", ["raw", "gzip", "ascii"])
@pytest.mark.parametrize("kind", [*TYPES, ">u2", ">f8"])
def test_nrrd(kind: str, encoding: str, tmp_path: Path) -> None:
    a = samples(kind) if kind != "u8" else samples("u4").astype("u8") << 20  # pynrrd writes larger ones as floats
    found = read(nrrd_file(a, tmp_path, encoding=encoding), "a.nrrd")
    np.testing.assert_allclose(found.array, a, rtol=1e-6 if encoding == "ascii" else 0)
    assert found.array.dtype.newbyteorder("=") == a.dtype.newbyteorder("=")
    assert found.spacing_mm is found.origin_mm is None


def test_nrrd_of_several_gzip_members(tmp_path: Path) -> None:
    a = samples()
    head, _, _ = nrrd_file(a, tmp_path, encoding="gzip").partition(b"\n\n")
    half = a.nbytes // 2
    content = head + b"\n\n" + gzip.compress(a.tobytes()[:half], mtime=0) + gzip.compress(a.tobytes()[half:], mtime=0)
    agree(read(content, "a.nrrd").array, a)


def test_nrrd_places(tmp_path: Path) -> None:
    """Rows of the directions are the file's axes, x first; the origin is the first sample's centre."""
    a = samples()
    header = {"space dimension": 3, "space directions": np.diag([0.1, 0.2, 0.4]), "space origin": [1.0, -2.0, 3.0]}
    found = read(nrrd_file(a, tmp_path, **header), "a.nrrd")
    assert found.spacing_mm == pytest.approx((0.1, 0.2, 0.4))
    assert found.origin_mm == pytest.approx((1, -2, 3))
    assert not found.at_corners
    header["space units"] = ["cm", "cm", "cm"]
    found = read(nrrd_file(a, tmp_path, **header), "a.nrrd")
    assert found.spacing_mm == pytest.approx((1, 2, 4))
    assert found.origin_mm == pytest.approx((10, -20, 30))
    assert read(nrrd_file(a, tmp_path, centerings=["node"] * 3), "a.nrrd").at_corners
    assert read(nrrd_file(a, tmp_path, spacings=[0.1, 0.2, 0.3]), "a.nrrd").spacing_mm == pytest.approx((0.1, 0.2, 0.3))


def test_nrrd_axis_that_runs_backwards(tmp_path: Path) -> None:
    a = samples()
    header = {"space dimension": 3, "space directions": np.diag([0.1, -0.2, 0.4]), "space origin": [1.0, 2.0, 3.0]}
    found = read(nrrd_file(a, tmp_path, **header), "a.nrrd")
    agree(found.array, a[:, ::-1])
    assert found.spacing_mm == pytest.approx((0.1, 0.2, 0.4))
    assert found.origin_mm == pytest.approx((1, 2 - 3 * 0.2, 3))


def test_nrrd_components(tmp_path: Path) -> None:
    """First axis as tools write them, or wherever `kinds` say; symmetric matrices are xx xy xz yy yz zz there."""
    a = samples("f4", (*SHAPE, 3))
    agree(read(nrrd_file(a, tmp_path), "a.nrrd").array, a)
    last = nrrd_file(np.moveaxis(a, -1, 0), tmp_path, kinds=["domain", "domain", "domain", "vector"])
    agree(read(last, "a.nrrd").array, a)
    none = [[np.nan] * 3, [0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.4]]
    header = {"space dimension": 3, "space directions": none, "space origin": [1.0, 2.0, 3.0]}
    found = read(nrrd_file(a, tmp_path, **header), "a.nrrd")
    agree(found.array, a)
    assert found.spacing_mm == pytest.approx((0.1, 0.2, 0.4))
    t = samples("f4", (*SHAPE, 6))
    xx, yy, zz, xy, yz, xz = np.moveaxis(t, -1, 0)
    rows = np.stack([xx, xy, xz, yy, yz, zz], axis=-1)
    kinds = ["3D-symmetric-matrix", "domain", "domain", "domain"]
    agree(read(nrrd_file(rows, tmp_path, kinds=kinds), "a.nrrd").array, t)


TIFFS: dict[str, dict[str, Any]] = {
    "plain": {}, "big endian": {"byteorder": ">"}, "BigTIFF": {"bigtiff": True}, "zlib": {"compression": "zlib"},
    "predictor": {"compression": "zlib", "predictor": 2}, "tiles": {"tile": (16, 16)}, "strips": {"rowsperstrip": 3},
    "packed strips": {"rowsperstrip": 3, "compression": "zlib"},
    "packed tiles": {"tile": (16, 16), "compression": "zlib"},
    "without description": {"metadata": None},
}  # fmt: skip


@pytest.mark.parametrize("settings", TIFFS.values(), ids=TIFFS)
@pytest.mark.parametrize("kind", ["u1", "u2", "u4", "f4", "f8"])
def test_tiff(kind: str, settings: dict[str, Any]) -> None:
    if settings.get("predictor") and kind[0] == "f":
        settings = {**settings, "predictor": None}
    a = samples(kind)
    found = read(tiff(a, **settings), "a.tif")
    agree(found.array, a)
    assert found.spacing_mm is found.origin_mm is None


@pytest.mark.parametrize("settings", [{}, {"planarconfig": "contig"}, {"planarconfig": "separate"}])
def test_tiff_components(settings: dict[str, Any]) -> None:
    a = samples("f4", (*SHAPE, 3))
    stored = np.moveaxis(a, -1, 1) if settings.get("planarconfig") == "separate" else a
    if settings.get("planarconfig") == "separate":
        settings = {**settings, "metadata": None}
    agree(read(tiff(stored, **settings), "a.tif").array, a)
    rgb = samples("u1", (*SHAPE, 3))
    agree(read(tiff(rgb, photometric="rgb"), "a.tiff").array, rgb)


def test_tiff_of_one_page_per_height_and_of_shape_one() -> None:
    a = samples("u2", (1, 4, 5))
    agree(read(tiff(a), "a.tif").array, a)


def test_tiff_ome() -> None:
    a = samples()
    sizes = {"PhysicalSizeX": 50.0, "PhysicalSizeXUnit": "µm", "PhysicalSizeY": 0.1, "PhysicalSizeYUnit": "mm"}
    metadata = {"axes": "ZYX", **sizes, "PhysicalSizeZ": 200.0}  # µm where there is no unit
    found = read(tiff(a, ome=True, metadata=metadata), "a.tif")
    agree(found.array, a)
    assert found.spacing_mm == pytest.approx((0.05, 0.1, 0.2))
    assert found.origin_mm is None
    assert read(tiff(a, ome=True, metadata={"axes": "ZYX", **sizes}), "a.tif").spacing_mm is None
    b = samples("f4", (*SHAPE, 3))
    for axes, stored in (("ZCYX", np.moveaxis(b, -1, 1)), ("CZYX", np.moveaxis(b, -1, 0)), ("ZYXS", b)):
        kind = "rgb" if axes == "ZYXS" else "minisblack"
        agree(read(tiff(stored, ome=True, photometric=kind, metadata={"axes": axes}), "a.tif").array, b)


def test_tiff_imagej() -> None:
    a = samples("f4")
    metadata = {"axes": "ZYX", "spacing": 0.4, "unit": "mm"}
    found = read(tiff(a, imagej=True, resolution=(10, 5), metadata=metadata), "a.tif")
    agree(found.array, a)
    assert found.spacing_mm == pytest.approx((0.1, 0.2, 0.4))
    assert found.origin_mm is None
    assert read(tiff(a, imagej=True, metadata={"axes": "ZYX"}), "a.tif").spacing_mm is None
    b = samples("f4", (*SHAPE, 3))
    agree(read(tiff(np.moveaxis(b, -1, 1), imagej=True, metadata={"axes": "ZCYX"}), "a.tif").array, b)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("header", [4, 8])
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("form", ["base64", "raw", "appended"])
def test_vti(form: str, packed: bool, header: int, order: str) -> None:
    for kind in TYPES:
        arrays = {"first": samples(kind), "second": samples("f4", (*SHAPE, 3))}
        content = vti(arrays, form=form, packed=packed, header=header, order=order)
        for key, a in arrays.items():
            agree(read(content, "a.vti", key).array, a)


@pytest.mark.parametrize("kind", TYPES)
def test_vti_ascii(kind: str) -> None:
    a = samples(kind)
    agree(read(vti({"only": a}, form="ascii"), "a.vti").array, a)


def test_vti_places() -> None:
    """Points lie at the corners of the cells, from the origin on; a piece may begin elsewhere."""
    a, geometry = samples(), 'Origin="1 2 3" Spacing="0.1 0.2 0.4"'
    points = read(vti({"a": a}, "PointData", geometry=geometry), "a.vti")
    cells = read(vti({"a": a}, "CellData", geometry=geometry), "a.vti")
    agree(points.array, a)
    assert points.spacing_mm == cells.spacing_mm == pytest.approx((0.1, 0.2, 0.4))
    assert points.origin_mm == pytest.approx((1, 2, 3))
    assert cells.origin_mm == pytest.approx((1.05, 2.1, 3.2))
    assert points.at_corners
    assert not cells.at_corners
    moved = read(vti({"a": a}, "PointData", geometry=geometry, start=(2, -1, 5)), "a.vti")
    assert moved.origin_mm == pytest.approx((1.2, 1.8, 5))


# Written by VTK 9.7.2: 2 x 2 x 3 points of 0, 1000, … 11000; two cells of (-0.5, -0.25, 0) and (0.25, 0.5, 0.75).
BY_VTK = b"""<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="BigEndian" header_type="UInt64" compressor="vtkZLibDataCompressor">
  <ImageData WholeExtent="0 1 0 1 0 2" Origin="1 2 3" Spacing="0.1 0.2 0.4" Direction="1 0 0 0 1 0 0 0 1">
  <Piece Extent="0 1 0 1 0 2">
    <PointData>
      <DataArray type="UInt16" Name="p" format="binary" RangeMin="0" RangeMax="11000">
        AAAAAAAAAAEAAAAAAACAAAAAAAAAAAAYAAAAAAAAACA=eF5jYGB+wX6Bewf/AuEO8QLpCHkHZQ11Aa0fAFMSBs0=
      </DataArray>
    </PointData>
    <CellData>
      <DataArray type="Float32" Name="c" NumberOfComponents="3" format="binary" RangeMin="0.5590169943749475" RangeMax="0.9354143466934853">
        AAAAAAAAAAEAAAAAAACAAAAAAAAAAAAYAAAAAAAAABo=eF7bz8DAsK+BAQzsgLQ9kLZ3YGAAADZ0A3o=
        <InformationKey name="L2_NORM_RANGE" location="vtkDataArray" length="2">
          <Value index="0">
            0.55901699437
          </Value>
          <Value index="1">
            0.93541434669
          </Value>
        </InformationKey>
      </DataArray>
    </CellData>
  </Piece>
  </ImageData>
</VTKFile>
"""  # noqa: E501


def test_vti_as_vtk_writes_it() -> None:
    points, cells = read(BY_VTK, "a.vti", "p"), read(BY_VTK, "a.vti", "c")
    agree(points.array, 1000 * np.arange(12, dtype="u2").reshape(3, 2, 2))
    agree(cells.array, (np.arange(6, dtype="f4") / 4 - 0.5).reshape(2, 1, 1, 3))
    assert points.origin_mm == pytest.approx((1, 2, 3))
    assert cells.origin_mm == pytest.approx((1.05, 2.1, 3.2))


def test_vti_chooses_between_points_and_cells() -> None:
    a, b = samples("u2", (2, 2, 2)), samples("u2", (1, 1, 1))
    content = vti({"v": a}, "PointData", form="ascii").replace(
        b"</PointData>", f'</PointData><CellData><DataArray type="UInt16" Name="v" format="ascii">{b[0, 0, 0]}'.encode()
        + b"</DataArray></CellData>",
    )  # fmt: skip
    agree(read(content, "a.vti", "PointData/v").array, a)
    agree(read(content, "a.vti", "CellData/v").array, b)
    with pytest.raises(JobError, match=r"holds 2 arrays: PointData/v, CellData/v"):
        read(content, "a.vti")


# Without a copy


def test_plain_samples_stay_in_the_file(tmp_path: Path) -> None:
    a = samples("f4")
    plain = {
        "a.npy": npy(a),
        "a.nrrd": nrrd_file(a, tmp_path, encoding="raw"),
        "a.tif": tiff(a),
        "a.vti": vti({"a": a}),
    }
    for name, content in plain.items():
        found = read(content, name).array
        assert np.shares_memory(found, np.frombuffer(content, np.uint8)), name
        assert not found.flags.writeable


def test_large_files_are_mapped_and_noticed_when_they_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "SMALLEST_MAPPED", 100)
    content, file = npy(samples()), tmp_path / "a.npy"
    file.write_bytes(content)
    (tmp_path / "small.npy").write_bytes(b"short")
    inputs = Inputs(tmp_path)
    assert inputs.map("small.npy") == b"short"
    assert inputs.map("a.npy") == content
    assert inputs.map("a.npy") is inputs.map("a.npy")
    assert (list(inputs.files), list(inputs.maps)) == (["small.npy"], ["a.npy"])
    assert inputs.map("a.npy").readonly
    file.write_bytes(content + b" ")
    with pytest.raises(JobError, match=r"'a\.npy' changed while it was in use"):
        inputs.map("a.npy")
    for name, why in (("../x", "outside the job file's folder"), (".", "not a regular file"), ("no", "cannot be read")):
        with pytest.raises(JobError, match=why):
            inputs.map(name)
    monkeypatch.setattr(source, "MAX_FILE_BYTES", 10)
    with pytest.raises(JobError, match="at most 10 are read"):
        Inputs(tmp_path).map("a.npy")


# Refusals of every type


def of_each_type(a: Array, folder: Path) -> dict[str, bytes]:
    """The same array as each type that can hold it."""
    made: dict[str, Callable[[], bytes]] = {
        "npy": lambda: npy(a),
        "npz": lambda: npz(a=a),
        "nrrd": lambda: nrrd_file(a, folder, encoding="raw"),
        "tif": lambda: tiff(a),
        "vti": lambda: vti({"a": a}),
    }
    return {f"a.{suffix}": make() for suffix, make in made.items()}


def packed_of_each_type(a: Array, folder: Path) -> dict[str, bytes]:
    return {
        "a.npz": npz(a=a),
        "a.nrrd": nrrd_file(a, folder, encoding="gzip"),
        "a.tif": tiff(a, compression="zlib"),
        "a.vti": vti({"a": a}, packed=True),
    }


def refused(content: bytes, name: str, why: str, key: str | None = None) -> JobError:
    with pytest.raises(JobError, match=why) as caught:
        read(content, name, key)
    assert name in caught.value.message
    assert caught.value.hint
    return caught.value


def test_signed_integers(tmp_path: Path) -> None:
    for name, content in of_each_type(samples("u2").astype("i2"), tmp_path).items():
        error = refused(content, name, "holds signed integers")
        assert error.hint is not None
        assert "floats" in error.hint


def test_truncated_data(tmp_path: Path) -> None:
    """Cut anywhere, it is refused, and never shows samples that are not there."""
    a = samples("f4", (6, 7, 8))
    for made in (of_each_type(a, tmp_path), packed_of_each_type(a, tmp_path)):
        for name, content in made.items():
            ends = [0, 1, 3, 7, *np.linspace(8, len(content) - 60, 25).astype(int)]
            for end in ends:
                refused(content[:end], name, ".")
    refused(npy(a)[:-1], "a.npy", r"cut short: its samples take 1344 bytes and 1343 are there")
    refused(nrrd_file(a, tmp_path, encoding="raw")[:-1], "a.nrrd", "cut short: its samples take 1344 bytes and 1343")


def test_damaged_bytes_give_no_other_error(tmp_path: Path) -> None:
    """A byte changed anywhere: the file is refused, or still read."""
    a = samples("u2")
    for made in (of_each_type(a, tmp_path), packed_of_each_type(a, tmp_path)):
        for name, content in made.items():
            for at in RNG.integers(0, len(content), 60):
                changed = bytearray(content)
                changed[at] ^= int(RNG.integers(1, 256))
                try:
                    found = read(bytes(changed), name)
                except JobError:
                    continue
                assert found.array.size <= 10 * a.size


def test_a_name_that_lies(tmp_path: Path) -> None:
    made = of_each_type(samples(), tmp_path)
    for name in made:
        for other, content in made.items():
            if other != name:
                refused(content, name, r"is not a (npy|npz|NRRD|TIFF|VTI) file|damaged XML")
    assert set(READERS) == {"npy", "npz", "nrrd", "nhdr", "tif", "tiff", "vti"}
    refused(made["a.npy"], "a.mat", r"ends in '\.mat'; \.npy, \.npz.* are read")
    agree(read(made["a.npy"], "A.NPY").array, read(made["a.npy"], "a.npy").array)


def test_wrong_number_of_axes(tmp_path: Path) -> None:
    for shape in ((5,), (4, 5), (2, 3, 4, 50), (2, 2, 3, 4, 3)):
        refused(npy(np.zeros(shape, "u1")), "a.npy", f"has {len(shape)} axes")
        refused(npz(a=np.zeros(shape, "u1")), "a.npz", f"has {len(shape)} axes")
    for shape in ((4, 5), (2, 3, 4, 50)):
        refused(nrrd_file(np.zeros(shape, "u1"), tmp_path), "a.nrrd", f"has {len(shape)} axes")
    error = refused(tiff(np.zeros((4, 5), "u1")), "a.tif", "has 2 axes")
    assert "image" in str(error.hint)
    refused(vti({"a": np.zeros((2, 3, 4, 10), "u1")}), "a.vti", "has 4 axes")
    assert "moveaxis" in str(refused(npy(np.zeros((3, 20, 20, 20), "u1")), "a.npy", "has 4 axes").hint)
    refused(npy(np.zeros((0, 4, 5))), "a.npy", "no samples")


def test_numbers_of_other_kinds() -> None:
    records = np.zeros(SHAPE, np.dtype([(f"field_{i}", "f4") for i in range(400)]))
    for content, name in ((npy(records), "a.npy"), (npz(a=records), "a.npz")):
        error = refused(content, name, "records")
        assert len(error.message) < 200
    for a in (np.zeros(SHAPE, "c8"), np.zeros(SHAPE, "U3"), np.zeros(SHAPE, "M8[s]"), np.zeros(SHAPE, "S2")):
        refused(npy(a), "a.npy", "unsigned integers, floats of 16 to 64 bits and bool are read")
    if np.dtype(np.longdouble).itemsize > 8:
        refused(npy(np.zeros(SHAPE, np.longdouble)), "a.npy", "float128|longdouble")
    refused(tiff(np.zeros(SHAPE, "c8")), "a.tif", "complex64")


def test_too_large_is_refused_on_the_declared_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    a = np.zeros((20, 20, 20), "u1")
    made = [*of_each_type(a, tmp_path).items(), *packed_of_each_type(a, tmp_path).items()]
    monkeypatch.setattr(checks, "MAX_FILE_BYTES", 7999)
    for name, content in made:
        refused(content, name, r"declares 20 × 20 × 20 samples, 8000 bytes; at most 7999 are read")


def test_keys_where_there_are_no_names(tmp_path: Path) -> None:
    for name, content in of_each_type(samples(), tmp_path).items():
        why = "holds one array without a name" if name[2:] in ("npy", "nrrd", "tif") else "has no array 'b'; it holds a"
        refused(content, name, why, key="b")


# Refusals of one type


def test_pickles() -> None:
    a = np.empty((1, 1, 1), object)
    a[0, 0, 0] = print
    refused(npy(a), "a.npy", "Python objects")
    refused(npz(a=a), "a.npz", "Python objects")
    refused(b"\x80\x04]\x94.", "a.npy", "is not a npy file")


def header_of(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode("latin1")


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"\x93NUMPY\x01\x00\xff\xff{'descr'", "header of 65535 bytes in a file of 18"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\x7f{", "header of 2147483647 bytes"),
        (b"\x93NUMPY\x07\x00", "version 7"),
        (header_of("not a header\n"), "damaged header"),
        (header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 2, 3)}\n"), "no samples"),
        (header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (9, 9, 10**9)}\n"), "damaged header"),
        (header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (9, 9, 999999999999)}\n"), "at most"),
        (header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 2, 2)}\n") + b"123", "32 bytes and 3 are"),
        (npy(np.zeros(SHAPE)) + b"more", "4 bytes more than its header declares"),
    ],
)  # fmt: skip
def test_npy_headers(content: bytes, why: str) -> None:
    refused(content, "a.npy", why)


def test_npz_of_several_arrays_without_a_key() -> None:
    a = samples()
    error = refused(npz(ratio=a, angle=a), "a.npz", "holds 2 arrays: ratio, angle")
    assert error.hint == "choose one of them, for example key: ratio"
    assert len(refused(npz(**{f"array{i}": np.zeros(1) for i in range(500)}), "a.npz", "500 arrays").message) < 300


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def test_npz_bombs_are_refused_on_their_declared_size(monkeypatch: pytest.MonkeyPatch) -> None:
    from amslicer.volumefiles import npz as module

    monkeypatch.setattr(module, "MAX_FILE_BYTES", 10_000)
    refused(zipped({"a.npy": bytes(20_000)}), "b.npz", r"b\.npz: a\.npy' unpacks to 20000 bytes; at most 10000")
    # One that declares less than it unpacks to gives no byte more, and its checksum is wrong then.
    honest = npz(a=np.zeros((40, 40, 40), "u1"))
    lying = honest.replace(struct.pack("<I", 64_128), struct.pack("<I", 9_000))
    assert lying != honest
    refused(lying, "a.npz", "damaged|cut short")


def test_npz_members_that_are_no_arrays() -> None:
    refused(zipped({"readme.txt": b"hello"}), "a.npz", "is not a plain array")
    refused(zipped({"a.npy": b"hello"}), "a.npz", "is not a npy file")
    refused(zipped({}), "a.npz", "holds no array")
    refused(zipped({"a.npy": npy(samples())}, zipfile.ZIP_BZIP2), "a.npz", "compressed by method 12")
    twice = zipped({"a.npy": npy(samples()), "b.npy": npy(samples())}).replace(b"b.npy", b"a.npy")
    refused(twice, "a.npz", "of the same name")


def nrrd_text(fields: str, data: bytes = bytes(8)) -> bytes:
    base = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n"
    return (base + fields).encode() + b"\n" + data


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (nrrd_text("data file: other.raw\n"), "samples lie in another file"),
        (nrrd_text("datafile: /etc/passwd\n"), "samples lie in another file"),
        (b"NRRD0004\ntype: uchar\ndata file: other.raw\n", "samples lie in another file"),
        (nrrd_text("byte skip: -1\n"), "byte skip"),
        (nrrd_text("line skip: 2\n"), "line skip"),
        (nrrd_text("sizes: 2 2 2\n"), "damaged header.*Duplicate"),
        (nrrd_text("", bytes(9)), "1 bytes more"),
        (nrrd_text("").replace(b"raw", b"bzip2"), "encoding bzip2; raw, gzip and text are read"),
        (nrrd_text("").replace(b"uchar", b"block"), "are read"),
        (nrrd_text("").replace(b"uchar", b"float"), "little or big endian"),
        (nrrd_text("").replace(b"2 2 2", b"2 2"), "declares 3 axes and 2 sizes"),
        (nrrd_text("").replace(b"2 2 2", b"2 2 x"), "damaged header"),
        (nrrd_text("").replace(b"2 2 2", b"2 2 -2"), "no samples"),
        (nrrd_text("").replace(b"sizes: 2 2 2\n", b""), "header without sizes"),
        (nrrd_text("").replace(b"NRRD0004", b"NRRD0009"), "damaged header"),
        (b"NRRD0004\n" + b"# notes\n" * 200_000, "no end of its header"),
        (nrrd_text("").replace(b"raw", b"gzip"), "is damaged"),
        (nrrd_text("", gzip.compress(bytes(1000), mtime=0)).replace(b"raw", b"gzip"), "bytes more than its header"),
        (nrrd_text("", b"1 2 3").replace(b"raw", b"text"), "declares 8 samples and holds 3"),
        (nrrd_text("", b"1 2 3 4 5 6 7 256").replace(b"raw", b"text"), "no uint8"),
        (nrrd_text("space: RAS\nspace directions: (1,0,0) (0,1,0) (0,0,0)\n"), "askew"),
        (nrrd_text("space: RAS\nspace directions: (1,0.1,0) (0,1,0) (0,0,1)\n"), "lies askew: .*along x, y, z"),
        (nrrd_text("space: RAS\nspace directions: (0,1,0) (1,0,0) (0,0,1)\n"), "lies askew"),
        (nrrd_text("space: RAS\nspace directions: (nan,0,0) (0,1,0) (0,0,1)\n"), "not three vectors"),
        (nrrd_text('space: RAS\nspace units: "furlong" "mm" "mm"\nspacings: 1 1 1\n'), "space units furlong, mm"),
    ],
)  # fmt: skip
def test_nrrd_headers(content: bytes, why: str) -> None:
    refused(content, "a.nrrd", why)


def test_nrrd_frames_of_vectors_that_are_turned(tmp_path: Path) -> None:
    header = {"space dimension": 3, "measurement frame": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]}
    refused(nrrd_file(samples("f4", (*SHAPE, 3)), tmp_path, **header), "a.nrrd", "measures its vectors in a frame")
    seven = nrrd_file(
        samples("f4", (*SHAPE, 7)), tmp_path, kinds=["3D-masked-symmetric-matrix", "domain", "domain", "domain"]
    )
    refused(seven, "a.nrrd", "masked tensors")


def test_tiffs_that_mean_something_else() -> None:
    a = samples("u1")
    refused(tiff(a, photometric="miniswhite"), "a.tif", "PhotometricInterpretation 0")
    refused(tiff(a, extratags=[(274, "H", 1, 3, True)]), "a.tif", "Orientation 3 in page 0")
    refused(tiff(a, compression="lzma"), "a.tif", "compressed by LZMA")
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream) as writer:
        writer.write(samples("u1", (4, 5)), photometric="minisblack")
        writer.write(samples("u1", (2, 3)), photometric="minisblack")
    refused(stream.getvalue(), "a.tif", "pages of several kinds")
    refused(tiff(np.zeros((2, *SHAPE), "u1"), ome=True, metadata={"axes": "TZYX"}), "a.tif", "has 2 times")
    refused(tiff(a, volumetric=True, tile=(16, 16, 16)), "a.tif", "ImageDepth")


def test_tiff_strips_that_unpack_to_more_or_less() -> None:
    a = np.zeros((2, 50, 40), "u1")
    content = tiff(a, compression="zlib", metadata=None)
    right = zlib.compress(bytes(2000), 6)
    assert right in content
    for wrong in (zlib.compress(bytes(1000), 6), zlib.compress(bytes(4000), 6)):
        assert len(wrong) <= len(right) + 4
        changed = content.replace(
            right, wrong.ljust(len(right), b"\0")[: len(right)] if len(wrong) < len(right) else wrong
        )
        refused(changed, "a.tif", "cut short|more than|damaged|cannot be read|OffsetS|strips")


def test_tiff_ome_does_not_look_elsewhere(tmp_path: Path) -> None:
    """Names of other files in the description are not followed."""
    content = tiff(samples(), ome=True, metadata={"axes": "ZYX"})
    text = content.replace(b"<TiffData ", b"<TiffDaXX ", 1)
    assert read(text, "a.tif").array.shape == SHAPE
    bomb = content.replace(b'<?xml version="1.0" encoding="UTF-8"?>', b'<?xml version="1.0"?><!DOCTYPE a []>  ', 1)
    refused(bomb, "a.tif", "DOCTYPE")


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("<VTKFile", '<!DOCTYPE x [<!ENTITY a "b">]><VTKFile', "DOCTYPE"),
        ("<VTKFile", '<!DOCTYPE x SYSTEM "file:///etc/passwd"><VTKFile', "DOCTYPE"),
        ("<CellData>", "<a>" * 40 + "<CellData>", "levels"),
        ('type="ImageData"', 'type="PolyData"', "is not a VTI file: VTKFile PolyData"),
        ('byte_order="LittleEndian"', 'byte_order="Middle"', "byte_order Middle"),
        ('header_type="UInt32"', 'header_type="UInt16"', "header_type UInt16"),
        ('header_type="UInt32"', 'header_type="UInt32" compressor="vtkLZ4DataCompressor"', "vtkLZ4DataCompressor"),
        ('Piece Extent="0 5', 'Piece Extent="0 4', "piece .* of the whole"),
        ("<Piece", "<Nothing/><Piece2", "has 0 pieces|damaged XML"),
        ('Spacing="1 1 1"', 'Spacing="1 0 1"', "Spacing"),
        ('Spacing="1 1 1"', 'Spacing="1 nan 1"', "Spacing '1 nan 1'; 3 numbers"),
        ('Spacing="1 1 1"', 'Spacing="1 1 1" Direction="0 1 0 1 0 0 0 0 1"', "lies askew"),
        ('Origin="0 0 0"', 'Origin="0 0"', "Origin '0 0'; 3 numbers"),
        ('WholeExtent="0 5', 'WholeExtent="0 5.5', "WholeExtent"),
        ('offset="0"', 'offset="100000"', "offset 100000"),
        ('offset="0"', 'offset="-4"', "offset -4"),
        ('type="UInt16"', 'type="UInt32"', "declares 120 bytes of samples, and its extent takes 240"),
        ('type="UInt16"', 'type="String"', "holds String"),
        ('type="UInt16"', 'type="Int16"', "signed integers"),
        ('encoding="raw"', 'encoding="hex"', "encoding hex"),
        ('format="appended"', 'format="other"', "format other"),
        ('NumberOfComponents="1"', 'NumberOfComponents="x"', "NumberOfComponents"),
    ],
)  # fmt: skip
def test_vti_headers(old: str, new: str, why: str) -> None:
    content = vti({"a": samples()})
    assert old.encode() in content
    refused(content.replace(old.encode(), new.encode()), "a.vti", why)


def test_vti_arrays() -> None:
    a = samples()
    refused(vti({"one": a, "two": a}), "a.vti", "holds 2 arrays: one, two")
    for old, new in ((b">", b"> 7 "), (b"</DataArray>", b" x</DataArray>")):
        content = vti({"a": a}, form="ascii")
        at = content.index(b'format="ascii"')
        refused(content[:at] + content[at:].replace(old, new, 1), "a.vti", "bytes more|no uint16")
    content = vti({"a": a}, form="base64")
    at = content.index(b'format="binary">') + 40
    refused(content[:at] + b"!" + content[at + 1 :], "a.vti", "damaged base64")
    bomb = vti({"a": np.zeros((30, 30, 30), "u1")}, packed=True)
    blocks = 27_000 // BLOCK + 1
    assert struct.pack("<III", blocks, BLOCK, 27_000 % BLOCK) in bomb
    for wrong in ((blocks, BLOCK - 1, 0), (2**31, BLOCK, 0)):
        changed = bomb.replace(struct.pack("<III", blocks, BLOCK, 27_000 % BLOCK), struct.pack("<III", *wrong))
        refused(changed, "a.vti", "declares .* bytes of samples|cut short")


def strips(a: Array, rows: int, padded: int) -> bytes:
    """A TIFF file of (z, y, x) bytes by hand: strips one after another, each of so many bytes more than it needs."""
    pages = [[page[i : i + rows].tobytes() + b"\xff" * padded for i in range(0, len(page), rows)] for page in a]
    content = bytearray(b"II*\0\0\0\0\0" + b"".join(piece for pieces in pages for piece in pieces))
    ends, start = 4, 8
    for pieces in pages:
        lengths = np.array([*map(len, pieces)], "<u4")
        starts = (start + np.cumsum(lengths) - lengths).astype("<u4")
        start += int(lengths.sum())
        at = {273: len(content), 279: len(content) + starts.nbytes}
        content += starts.tobytes() + lengths.tobytes()
        content += bytes(len(content) % 2)
        content[ends : ends + 4] = struct.pack("<I", len(content))
        tags = {256: a.shape[2], 257: a.shape[1], 258: 8, 259: 1, 262: 1, 277: 1, 278: rows, **at}
        content += struct.pack("<H", len(tags))
        for tag in sorted(tags):
            content += struct.pack("<HHII", tag, 4, len(pieces) if tag in at else 1, tags[tag])
        ends = len(content)
        content += bytes(4)
    return bytes(content)


@pytest.mark.parametrize("padded", [0, 3])
def test_tiff_strips_that_are_padded(padded: int) -> None:
    """What a strip has beyond its rows belongs to no picture."""
    a = samples("u1", (3, 7, 5))
    agree(read(strips(a, 2, padded), "a.tif").array, a)
    refused(strips(a, 2, padded)[:40], "a.tif", "cut short|cannot be read")


@pytest.mark.parametrize("settings", [{}, {"rowsperstrip": 3}, {"predictor": 2}, {"tile": (16, 16)}])
@pytest.mark.parametrize("planes", [3, 4])
def test_tiff_as_the_hint_says_to_write_it(planes: int, settings: dict[str, Any]) -> None:
    """tifffile takes 3 or 4 planes of bytes for colours, each in a plane of its own, unless it is told otherwise."""
    a = samples("u1", (planes, 17, 20))
    stream = io.BytesIO()
    tifffile.imwrite(stream, a, compression="zlib", photometric="rgb", planarconfig="separate", **settings)
    agree(read(stream.getvalue(), "a.tif").array, a)


def test_tiff_refusals_are_the_only_lines(capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> None:
    content = bytearray(tiff(samples("u1", (3, 17, 20)), compression="zlib", metadata=None))
    for at in range(8, len(content), 7):
        with contextlib.suppress(JobError):
            read(bytes(content[:at]), "a.tif")
        changed = bytearray(content)
        changed[at] ^= 0xFF
        with contextlib.suppress(JobError):
            read(bytes(changed), "a.tif")
    assert not caplog.records
    assert capfd.readouterr() == ("", "")


def test_nrrd_units_of_axes(tmp_path: Path) -> None:
    """Spacings have units of their own axes: 2 mm are 0.002 m."""
    a, spacings = samples(), [2e-3, 1e-3, 4e-3]
    found = read(nrrd_file(a, tmp_path, spacings=spacings, units=["m", "m", "m"]), "a.nrrd")
    assert found.spacing_mm == pytest.approx((2, 1, 4))
    unknown = nrrd_file(a, tmp_path, spacings=spacings, units=["???", "", "none"])
    assert read(unknown, "a.nrrd").spacing_mm == pytest.approx(spacings)
    refused(nrrd_file(a, tmp_path, spacings=spacings, units=["m", "mm", "m"]), "a.nrrd", "units m, mm")
    refused(nrrd_file(a, tmp_path, spacings=spacings, units=["s", "s", "s"]), "a.nrrd", "units s")
    vectors = samples("f4", (*SHAPE, 3))
    kinds = ["vector", "domain", "domain", "domain"]
    header = {"spacings": [float("nan"), *spacings], "units": ["N", "m", "m", "m"], "kinds": kinds}
    assert read(nrrd_file(vectors, tmp_path, **header), "a.nrrd").spacing_mm == pytest.approx((2, 1, 4))
