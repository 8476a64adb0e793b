"""TIFF stacks: planes, channels, times and spacing as ImageJ and OME tell them."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from segment.picture import Picture, parse_picture, read_picture, write_labels, write_mask
from tspline.errors import FileFormatError


def rejected(data: bytes, told: str = "") -> None:
    with pytest.raises(FileFormatError) as caught:
        parse_picture(data, "scan")
    assert "\n" not in str(caught.value)
    assert told in str(caught.value)


def tiff(array: np.ndarray, **options: Any) -> bytes:
    stream = io.BytesIO()
    tifffile.imwrite(stream, array, **options)
    return stream.getvalue()


DEEP = np.random.default_rng(3).integers(0, 65535, (5, 9, 13)).astype(np.uint16)


@pytest.mark.parametrize("options", [{}, {"compression": "zlib"}, {"byteorder": ">"},
                                     {"compression": "zlib", "tile": (16, 16)}, {"bigtiff": True}])  # fmt: skip
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int32, np.float32, np.float64])
def test_pages_are_planes(options: dict[str, Any], kind: type) -> None:
    wanted = DEEP.astype(kind)
    picture = parse_picture(tiff(wanted, photometric="minisblack", metadata=None, **options), "a")
    np.testing.assert_array_equal(picture.pixels, wanted)
    assert (picture.is_volume, picture.geometry.is_physical, picture.spacing) == (True, False, (1.0, 1.0, 1.0))


@pytest.mark.parametrize("kind", ["tiff_lzw", "packbits", "tiff_adobe_deflate"])
def test_pages_by_pillow(kind: str) -> None:
    from PIL import Image

    stream = io.BytesIO()
    pages = [Image.fromarray(page) for page in DEEP]
    pages[0].save(stream, format="TIFF", save_all=True, append_images=pages[1:], compression=kind)
    np.testing.assert_array_equal(parse_picture(stream.getvalue(), "a").pixels, DEEP)


def test_colours_by_pillow() -> None:
    deep = np.random.default_rng(0).integers(0, 65535, (9, 13, 3)).astype(np.uint16)
    shallow = (deep >> 8).astype(np.uint8)
    _, data = cv2.imencodemulti(".tiff", [shallow, shallow[::-1].copy()])  # LZW, channels reversed
    picture = parse_picture(bytes(data), "a")
    assert picture.channel_axis == 3
    np.testing.assert_array_equal(picture.pixels[1], shallow[::-1, :, ::-1])
    _, data = cv2.imencodemulti(".tiff", [deep, deep])
    rejected(bytes(data), "uint16 with compression LZW")  # rather than eight of sixteen bits


def test_imagej_hyperstacks(tmp_path: Path) -> None:
    told = {"axes": "ZYX", "spacing": 3.5, "unit": "micron"}
    data = tiff(DEEP, imagej=True, resolution=(4.0, 2.0), metadata=told)
    picture = parse_picture(data, "a")
    assert (picture.spacing, picture.geometry.unit) == ((3.5, 0.5, 0.25), "um")
    np.testing.assert_allclose(picture.to_physical([[1.0, 2.0, 3.0]]), [[0.75, 1.0, 3.5]])
    write_labels(tmp_path / "l.tif", DEEP, picture)
    with tifffile.TiffFile(tmp_path / "l.tif") as file:
        assert file.imagej_metadata["spacing"] == 3.5
        assert file.imagej_metadata["unit"] == "micron"
        assert file.pages.first.tags["XResolution"].value == (4, 1)
        assert file.series[0].axes == "ZYX"
        np.testing.assert_array_equal(file.asarray(), DEEP)
    channels = np.stack([DEEP, DEEP[::-1]], axis=1)
    held = parse_picture(tiff(channels, imagej=True, metadata={"axes": "ZCYX"}), "a")
    assert held.channel_axis == 3
    np.testing.assert_array_equal(held.pixels, np.moveaxis(channels, 1, -1))
    flat = parse_picture(tiff(channels[0], imagej=True, metadata={"axes": "CYX"}), "a")
    assert (flat.is_volume, flat.num_channels) == (False, 2)
    times = parse_picture(tiff(DEEP, imagej=True, metadata={"axes": "TYX"}), "a")
    assert "times" in times.notes[0]
    with pytest.raises(FileFormatError, match="T times"):
        parse_picture(tiff(channels, imagej=True, metadata={"axes": "TZYX"}), "a")


def test_ome_sizes(tmp_path: Path) -> None:
    sizes = {"PhysicalSizeX": 250.0, "PhysicalSizeXUnit": "nm", "PhysicalSizeY": 0.5, "PhysicalSizeZ": 3.5}
    told = {"axes": "ZYX", **sizes, "PhysicalSizeYUnit": "µm", "PhysicalSizeZUnit": "µm"}
    picture = parse_picture(tiff(DEEP, ome=True, metadata=told), "a")
    np.testing.assert_allclose(picture.spacing, (3500.0, 500.0, 250.0))
    assert picture.geometry.unit == "nm"
    write_mask(tmp_path / "m.tif", DEEP > 99, picture)
    again = read_picture(tmp_path / "m.tif")
    assert (again.header, again.spacing, again.geometry.unit) == ("OME", picture.spacing, "nm")
    np.testing.assert_array_equal(again.pixels, 255 * (DEEP > 99))


def test_spacing_of_one_image(tmp_path: Path) -> None:
    picture = parse_picture(tiff(DEEP[0], imagej=True, resolution=(4.0, 4.0), metadata={"unit": "mm"}), "a")
    assert (picture.spacing, picture.geometry.unit) == ((0.25, 0.25), "mm")
    write_mask(tmp_path / "m.tif", DEEP[0] > 99, picture)
    again = read_picture(tmp_path / "m.tif")
    assert (again.spacing, again.geometry.unit) == ((0.25, 0.25), "mm")
    np.testing.assert_array_equal(again.pixels, 255 * (DEEP[0] > 99))
    printed = parse_picture(tiff(DEEP[0], resolution=(300, 300), resolutionunit="inch"), "a")
    assert not printed.geometry.is_physical


@settings(max_examples=60, deadline=None)
@given(st.floats(1e-7, 1e6))
def test_spacing_survives_the_ratio(side: float) -> None:
    picture = Picture(DEEP, parse_picture(tiff(DEEP), "a").geometry.with_spacing((side,) * 3), False, "TIFF")
    with tempfile.TemporaryDirectory() as folder:
        write_mask(Path(folder) / "m.tif", DEEP > 99, picture)
        # a ratio of two 32-bit numbers
        np.testing.assert_allclose(read_picture(Path(folder) / "m.tif").spacing, picture.spacing, rtol=1e-6)


def test_hostile_files() -> None:
    rejected(tiff(DEEP, photometric="minisblack")[:-100])
    rejected(tiff(DEEP, compression="lzma"), "LZMA")
    both = io.BytesIO()
    with tifffile.TiffWriter(both) as writer:
        writer.write(DEEP[0], metadata=None)
        writer.write(DEEP[0, :5], metadata=None)
    rejected(both.getvalue(), "2 images")


def test_a_strip_that_inflates_to_more() -> None:
    data = tiff(np.zeros((2, 400, 400), np.uint8), compression="zlib", photometric="minisblack", metadata=None)
    # the second page's height, which the strips then exceed
    wrong = data.replace(
        b"\x01\x01\x04\x00\x01\x00\x00\x00\x90\x01\x00\x00", b"\x01\x01\x04\x00\x01\x00\x00\x00\x05\x00\x00\x00"
    )
    wrong = wrong.replace(
        b"\x16\x01\x04\x00\x01\x00\x00\x00\x90\x01\x00\x00", b"\x16\x01\x04\x00\x01\x00\x00\x00\x05\x00\x00\x00"
    )
    assert wrong != data
    rejected(wrong, "strip")
