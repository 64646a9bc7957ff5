"""Map files of ROS map_server and Nav2: a pgm (or png) image and a yaml beside it."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import (
    FREE,
    FREE_TO,
    MAX_CELLS,
    MAX_GB,
    OCCUPIED,
    OCCUPIED_FROM,
    UNKNOWN,
    OccupancyGrid,
)
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.yaml_files import load_model

# Trinary pixels of map_saver. 205 reads back as (255 - 205) / 255 = 0.19608, which is "unknown" only
# because free_thresh is 0.196: with Nav2's 0.25 it would load as free.
PIXEL_FREE, PIXEL_UNKNOWN, PIXEL_OCCUPIED = 254, 205, 0
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
READERS = ("PPM", "PNG", "BMP", "JPEG")
"""Pillow's own, named one by one: among the rest are some that start other programs."""


def _not_a_truth_value(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError(f"expected a number, not {str(value).lower()}")
    return value


def _share(value: float) -> float:
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"must be from 0, white, to 1, black, not {value:g}")
    return value


def _three_numbers(value: Any, validated: ValidatorFunctionWrapHandler) -> Any:
    try:
        return validated(value)
    except ValueError:  # it speaks of each number in turn
        raise ValueError("expected three numbers") from None


Real = Annotated[float, BeforeValidator(_not_a_truth_value)]
Share = Annotated[Real, AfterValidator(_share)]


class MapYaml(BaseModel):
    """Keys of a map yaml; unknown keys are ignored, as map_server does."""

    model_config = ConfigDict(extra="ignore")
    image: str
    resolution: Real = Field(ge=1e-4, le=100.0, allow_inf_nan=False, description="metres per pixel, as 0.05")
    origin: Annotated[tuple[Real, Real, Real], WrapValidator(_three_numbers)] = Field(
        description="x, y, yaw of the lower left corner, in metres and radians"
    )
    negate: int = 0
    occupied_thresh: Share = Field(description="0.65 in most maps")
    free_thresh: Share = Field(description="0.196 in most maps")
    mode: Literal["trinary", "scale", "raw"] = "trinary"


def save_map(grid: OccupancyGrid, folder: Path, name: str = "map") -> Path:
    """Write `name.pgm` and `name.yaml` (trinary, map_saver's thresholds); returns the yaml's path."""
    pixels = np.full(grid.shape, PIXEL_UNKNOWN, dtype=np.uint8)
    pixels[(grid.cells >= FREE) & (grid.cells <= FREE_TO)] = PIXEL_FREE
    pixels[grid.cells >= OCCUPIED_FROM] = PIXEL_OCCUPIED
    rows, cols = grid.shape
    header = f"P5\n# CREATOR: turtlebag {grid.resolution:.3f} m/pix\n{cols} {rows}\n255\n"
    (folder / f"{name}.pgm").write_bytes(header.encode() + pixels[::-1].tobytes())
    x, y, yaw = (float(value) for value in grid.T_map_grid.xyt)
    path = folder / f"{name}.yaml"
    path.write_text(
        f"image: {name}.pgm\nmode: trinary\nresolution: {grid.resolution:.6f}\n"
        f"origin: [{x:.6f}, {y:.6f}, {yaw:.6f}]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n"
    )
    return path


def save_confidence(confidence: NDArray[np.uint8], path: Path) -> None:
    """Write the probability of each cell (rows, cols), in 255ths, that it is as the map says: a pgm of the
    map's size, black for 0 to white for 1."""
    rows, cols = confidence.shape
    path.write_bytes(f"P5\n{cols} {rows}\n255\n".encode() + confidence[::-1].tobytes())


def load_map(path: Path) -> OccupancyGrid:
    """Read a map yaml and its image as map_server would; InputError if they are invalid."""
    meta = _read_yaml(path)
    image_path = _image_of(path, meta)
    if not image_path.is_file():
        raise InputError(f"{path}: its image {image_path} does not exist")
    cells = _read_cells(image_path, meta)
    try:
        return OccupancyGrid(cells, meta.resolution, SE2.from_xyt(*meta.origin))
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def map_files(path: Path) -> dict[str, Path]:
    """The two files of a map by the names a manifest gives them as inputs: `map`, `map_image`."""
    return {"map": path, "map_image": _image_of(path, _read_yaml(path))}


def _image_of(path: Path, meta: MapYaml) -> Path:
    return Path(meta.image) if Path(meta.image).is_absolute() else path.parent / meta.image


def _read_yaml(path: Path) -> MapYaml:
    if not path.is_file():
        raise InputError(f"{path}: no such map file (expected a map yaml)")
    meta = load_model(MapYaml, path)
    if not all(math.isfinite(value) and abs(value) < 1e7 for value in meta.origin):
        raise InputError(f"{path}: origin must be three finite numbers, none implausibly far away")
    return meta


def _read_cells(path: Path, meta: MapYaml) -> NDArray[np.int8]:
    """Cell values of an image, row 0 lowest. What is not opaque is unknown."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the limit here is lower
            image = Image.open(path, formats=READERS)
        with image:
            if image.width * image.height > MAX_CELLS:
                raise Image.DecompressionBombError
            values, top, opaque = _brightness(image)
    except Image.DecompressionBombError:
        limit = (
            f"the limit is {MAX_CELLS // 1_000_000} million pixels, with which localisation takes {MAX_GB} GB"
        )
        raise InputError(f"{path}: its image is too large ({limit}); crop or reduce it") from None
    except Exception:  # Pillow raises many types (SyntaxError among them) for damaged images
        raise InputError(f"{path}: not a readable image; PGM, PNG, BMP and JPEG are read") from None
    # One look-up a pixel: arithmetic on the whole image takes forty bytes for each.
    cells = _interpret(np.linspace(0.0, 255.0, top + 1), meta)[values[::-1]]
    if opaque is not None:
        cells[~opaque[::-1]] = UNKNOWN
    return cells


def _brightness(image: Image.Image) -> tuple[NDArray[np.unsignedinteger], int, NDArray[np.bool_] | None]:
    """The pixels, what white is among them, and which of them are opaque (None: all)."""
    if image.mode in ("1", "L"):
        return np.asarray(image.convert("L")), 255, None
    if image.mode.startswith("I"):
        return np.asarray(image).astype(np.uint16), 65535, None
    if image.mode == "F":
        raise ValueError("floating-point pixels have no white level")
    opaque = np.asarray(image.convert("RGBA").getchannel("A")) == 255 if image.has_transparency_data else None
    # The mean of the colours, as map_server takes it.
    red, green, blue = (np.asarray(band, dtype=np.uint16) for band in image.convert("RGB").split())
    return red + green + blue, 3 * 255, opaque


def _interpret(pixels: NDArray[np.float64], meta: MapYaml) -> NDArray[np.int8]:
    """Cell values of pixels from 0 to 255 by map_server's three modes; thresholds are strict."""
    if meta.negate:
        pixels = 255.0 - pixels
    if meta.mode == "raw":
        pixels = np.rint(pixels)
        return np.where(pixels <= 100, pixels, UNKNOWN).astype(np.int8)
    p = (255.0 - pixels) / 255.0
    if meta.mode == "scale" and meta.occupied_thresh > meta.free_thresh:
        ramp = (p - meta.free_thresh) / (meta.occupied_thresh - meta.free_thresh)
        between = 1.0 + np.floor(98.0 * np.clip(ramp, 0.0, 1.0))
    else:
        between = np.full_like(p, UNKNOWN)
    cells = np.where(p > meta.occupied_thresh, OCCUPIED, np.where(p < meta.free_thresh, FREE, between))
    return cells.astype(np.int8)
