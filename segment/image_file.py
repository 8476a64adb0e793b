"""Images from files, masks and labels to files."""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tspline.array_file import read_npy
from tspline.errors import FileFormatError

if TYPE_CHECKING:
    from PIL import Image

__all__ = ["LABEL_ENDINGS", "MASK_ENDINGS", "checked_image", "parse_image", "write_labels", "write_mask"]

AnyArray = npt.NDArray[np.generic]
BoolArray = npt.NDArray[np.bool_]

MASK_ENDINGS = (".png", ".tif", ".tiff", ".bmp", ".npy")
LABEL_ENDINGS = (".tif", ".tiff", ".png", ".npy")

MAX_PIXELS = 1 << 27
"""Larger images are refused (134 million pixels), so that a small file cannot ask for all memory."""

# named, since Pillow's list holds formats that start other programs (EPS); TIFF last, as it loads all plugins
_FORMATS = ("PNG", "JPEG", "BMP", "DIB", "PPM", "TIFF")
_ACCEPTED = "a complete PNG, JPEG, TIFF, BMP or PGM image, or a .npy array"


def parse_image(data: bytes, path: str) -> AnyArray:
    """Read one 2D image from a file's bytes; its content says the format.

    Parameters
    ----------
    data : bytes
        The whole file: PNG, JPEG, TIFF, BMP, PGM/PPM or .npy. Pixels are taken as stored: an EXIF rotation is not
        applied.
    path : str
        Its name for errors.

    Returns
    -------
    (rows, cols) or (rows, cols, 3) array
        bool, integer or floating point, as stored: nothing is scaled. Palettes are resolved to colours,
        transparent pixels are laid over white.

    Raises
    ------
    FileFormatError
        Damaged or truncated, of another kind, a stack of several images, empty, or too large.
    """
    if not data:
        raise FileFormatError(path, "the file is empty", _ACCEPTED)
    if data.startswith(b"\x93NUMPY"):
        array = read_npy(io.BytesIO(data), path, size=len(data))
        return checked_image(array, path)
    return checked_image(_decode(data, path), path)


def write_mask(path: str | os.PathLike[str], mask: BoolArray, *, ending: str | None = None) -> None:
    """Write a mask, 255 inside and 0 outside; .npy keeps bool.

    Parameters
    ----------
    path : path
        Written in place.
    mask : (rows, cols) bool array
    ending : str, optional
        One of `MASK_ENDINGS`; that of `path` by default.
    """
    kind = _ending(path, ending, MASK_ENDINGS)
    if kind == ".npy":
        _save_npy(path, mask)
        return
    _save(np.where(mask, np.uint8(255), np.uint8(0)), path, kind)


def write_labels(path: str | os.PathLike[str], labels: npt.NDArray[Any], *, ending: str | None = None) -> None:
    """Write object numbers as 16-bit integers, or 32-bit ones where there are more than 65,535 (TIFF, .npy).

    Parameters
    ----------
    path : path
        Written in place.
    labels : (rows, cols) int array
        0 is background.
    ending : str, optional
        One of `LABEL_ENDINGS`; that of `path` by default.

    Raises
    ------
    FileFormatError
        Too many objects for PNG.
    """
    kind = _ending(path, ending, LABEL_ENDINGS)
    highest = int(labels.max(initial=0))
    small = highest <= np.iinfo(np.uint16).max
    if kind == ".png" and not small:
        raise FileFormatError(path, f"{highest} objects", "at most 65535 in PNG; use .tif")
    numbers = labels.astype(np.uint16 if small else np.int32)
    if kind == ".npy":
        _save_npy(path, numbers)
        return
    _save(numbers, path, kind)


def _decode(data: bytes, path: str) -> AnyArray:
    """Pixels by Pillow, or by OpenCV where Pillow would drop the low byte of 16-bit colours."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # Pillow warns of damaged metadata and of large sizes; sizes are checked here
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
                _check_size(image.size, path)
                _check_single(image, path)
                if _is_deep_colour(image, data):
                    image.load()  # Pillow checks that the file is complete, OpenCV does not
                    return _by_opencv(data)
                return _pixels(image)
    except FileFormatError:
        raise
    except UnidentifiedImageError:
        if data[:4] in (b"II*\x00", b"MM\x00*"):
            return _by_tifffile(data, path)
        raise FileFormatError(path, "not an image of a known kind", _ACCEPTED) from None
    except MemoryError:
        raise
    except Exception as error:
        # decoders of damaged files end in errors of a dozen kinds; all mean the same to the caller
        raise FileFormatError(path, f"a damaged image ({_brief(error)})", _ACCEPTED) from None


def _check_size(size: tuple[int, int], path: str) -> None:
    if size[0] * size[1] > MAX_PIXELS:
        raise FileFormatError(path, f"{size[1]} x {size[0]} pixels", f"at most {MAX_PIXELS} pixels")


def _check_single(image: Image.Image, path: str) -> None:
    frames = getattr(image, "n_frames", 1)
    # MPO is how phones store a JPEG with a preview behind it
    if frames > 1 and image.format != "MPO":
        raise FileFormatError(path, f"a stack of {frames} images", "a file with one 2D image")


def _is_deep_colour(image: Image.Image, data: bytes) -> bool:
    """Whether there are several channels of 16 bits, of which Pillow would keep 8."""
    if image.format == "PNG":
        return data[24:26] in (b"\x10\x02", b"\x10\x04", b"\x10\x06")  # bits and kind of colour
    if image.format == "PPM":
        return image.mode == "RGB" and len(data) >= 6 * image.size[0] * image.size[1]
    if image.format == "TIFF" and len(image.getbands()) > 1:
        bits_per_sample: Any = getattr(image, "tag_v2", {}).get(258, ())
        return any(bits > 8 for bits in bits_per_sample)
    return False


def _by_opencv(data: bytes) -> AnyArray:
    import cv2

    pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise ValueError("cannot be decoded")
    deep: AnyArray = np.asarray(pixels)
    if deep.ndim == 2:
        return deep
    if deep.shape[2] == 3:
        return np.ascontiguousarray(deep[:, :, ::-1])
    return _over_white(deep[:, :, 2::-1], deep[:, :, 3:], float(np.iinfo(np.uint16).max))


def _by_tifffile(data: bytes, path: str) -> AnyArray:
    """Read the kinds of TIFF that Pillow does not know: 16-bit and floating-point colours, 64-bit numbers."""
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(data)) as stack:
            frames = len(stack.pages)
            page = stack.pages.first
            shape = page.shape
            if frames == 1 and len(shape) in (2, 3):
                _check_size((int(shape[1]), int(shape[0])), path)
                if int(np.prod(shape)) > 4 * MAX_PIXELS:
                    raise ValueError(f"shape {shape}")
                return np.asarray(page.asarray())
    except (FileFormatError, MemoryError):
        raise
    except Exception as error:  # as in _decode
        raise FileFormatError(path, f"a damaged image ({_brief(error)})", _ACCEPTED) from None
    raise FileFormatError(path, f"a stack of {frames} images of shape {shape}", "a file with one 2D image")


def _pixels(image: Image.Image) -> AnyArray:
    """Pixels as an array, of as many bits as are stored."""
    if image.mode == "P":
        image = image.convert("RGBA" if "transparency" in image.info else "RGB")
    elif image.mode in ("PA", "La", "RGBa"):
        image = image.convert("RGBA")
    elif image.mode in ("CMYK", "YCbCr", "LAB", "HSV", "RGBX"):
        image = image.convert("RGB")
    elif image.mode in ("L", "RGB") and "transparency" in image.info:
        image = image.convert("RGBA")
    pixels = np.asarray(image)
    if image.mode == "LA":
        return _over_white(pixels[:, :, :1], pixels[:, :, 1:], 255.0)[:, :, 0]
    if image.mode == "RGBA":
        return _over_white(pixels[:, :, :3], pixels[:, :, 3:], 255.0)
    return pixels


def _over_white(colour: AnyArray, alpha: AnyArray, full: float) -> AnyArray:
    """Lay transparent pixels over white, since colours under them mean nothing."""
    if bool(np.all(alpha == full)):
        return np.ascontiguousarray(colour)
    opacity = alpha.astype(np.float32) / full
    laid = colour.astype(np.float32) * opacity + full * (1.0 - opacity)
    rounded: AnyArray = (np.rint(laid) if colour.dtype.kind in "iu" else laid).astype(colour.dtype)
    return rounded


def checked_image(image: AnyArray, path: str) -> AnyArray:
    """Bring every way of storing one image to (rows, cols) or (rows, cols, 3), and refuse what is none."""
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim == 3 and image.shape[2] == 4:
        full = float(np.iinfo(image.dtype.name).max) if image.dtype.kind in "iu" else 1.0
        image = _over_white(image[:, :, :3], image[:, :, 3:], full)
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or image.dtype.kind not in "biuf":
        wrong = f"an array of type {image.dtype} and shape {image.shape}"
        raise FileFormatError(path, wrong, "numbers (rows, cols), (rows, cols, 3) or (rows, cols, 4)")
    if image.size == 0 or image.shape[0] * image.shape[1] > MAX_PIXELS:
        raise FileFormatError(path, f"an image of shape {image.shape}", f"1 to {MAX_PIXELS} pixels")
    if image.dtype.kind == "f" and not bool(np.isfinite(image).all()):
        raise FileFormatError(path, "pixels that are infinite or NaN", "finite numbers")
    return image


def _ending(path: str | os.PathLike[str], ending: str | None, accepted: tuple[str, ...]) -> str:
    kind = (ending or Path(path).suffix).lower()
    if kind not in accepted:
        raise FileFormatError(path, f"the ending {kind!r}", " ".join(accepted))
    return kind


def _save(pixels: npt.NDArray[Any], path: str | os.PathLike[str], kind: str) -> None:
    from PIL import Image

    image = Image.fromarray(pixels)
    with Path(path).open("wb") as stream:
        _encode(image, stream, kind)


def _encode(image: Image.Image, stream: IO[bytes], kind: str) -> None:
    if kind in (".tif", ".tiff"):
        image.save(stream, format="TIFF", compression="tiff_adobe_deflate")
    else:
        image.save(stream, format={".png": "PNG", ".bmp": "BMP"}[kind])


def _save_npy(path: str | os.PathLike[str], array: npt.NDArray[Any]) -> None:
    # through a stream, since np.save would add its ending to other names
    with Path(path).open("wb") as stream:
        np.save(stream, array, allow_pickle=False)


def _brief(error: BaseException) -> str:
    return (" ".join(str(error).split()) or type(error).__name__)[:80]
