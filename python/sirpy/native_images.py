"""The native images of a workspace and the sub-images that were cut of them: sir.json."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sirpy.errors import InputError
from sirpy.files import read_json, write_json
from sirpy.rectangle import Rectangle

_VERSION = 2


@dataclass(frozen=True)
class SubImage:
    """A rectangle of an undistorted native image, with the file that holds it.

    `core` are the pixels it owns (every pixel of the region that is cut has exactly one owner), `stored`
    the pixels in the file: the core and the overlap, clipped to the region. Both in native pixels.
    """

    name: str
    row: int
    column: int
    core: Rectangle
    stored: Rectangle


@dataclass(frozen=True)
class NativeImage:
    """An undistorted native image: size in pixels and the sub-images of the region that is cut, row by
    row; of an area those that see it.

    `white` is the sample value that shows as white, 255 unless samples have 16 bits; `masked` says
    that its sub-images have masks.
    """

    name: str
    width: int
    height: int
    sub_images: tuple[SubImage, ...]
    white: int = 255
    masked: bool = False

    @property
    def rectangle(self) -> Rectangle:
        return Rectangle(0, 0, self.width, self.height)

    @property
    def covered(self) -> Rectangle:
        """The smallest rectangle around all that the sub-images store; there is one at least."""
        stored = [sub.stored for sub in self.sub_images]
        return Rectangle.from_corners(
            min(one.x0 for one in stored),
            min(one.y0 for one in stored),
            max(one.x1 for one in stored),
            max(one.y1 for one in stored),
        )


@dataclass(frozen=True)
class LeftOut:
    """A photograph that could not be used, and why."""

    name: str
    reason: str


def write_index(path: Path, natives: list[NativeImage], left_out: list[LeftOut]) -> None:
    """Writes sir.json, whole or not at all. Raises OutputError."""
    write_json(
        path,
        {
            "version": _VERSION,
            "images": [
                {
                    "name": native.name,
                    "width": native.width,
                    "height": native.height,
                    "white": native.white,
                    "masked": native.masked,
                    "sub_images": [
                        {
                            "name": sub.name,
                            "row": sub.row,
                            "column": sub.column,
                            "core": sub.core.as_list(),
                            "stored": sub.stored.as_list(),
                        }
                        for sub in native.sub_images
                    ],
                }
                for native in natives
            ],
            "left_out": [{"name": out.name, "reason": out.reason} for out in left_out],
        },
    )


def read_index(path: Path) -> tuple[tuple[NativeImage, ...], tuple[LeftOut, ...]]:
    """What `write_index` wrote.

    Raises:
        FileNotFoundError: there is no such file.
        InputError: it is damaged, or of another version.
    """

    def parsed(index: Any) -> tuple[tuple[NativeImage, ...], tuple[LeftOut, ...]]:
        if index["version"] != _VERSION:
            raise InputError(
                f"{path} was made by another version of sirpy: delete it and cut again"
            )
        natives = tuple(_parsed_native(image) for image in index["images"])
        left_out = [LeftOut(str(out["name"]), str(out["reason"])) for out in index["left_out"]]
        if not all(native.sub_images for native in natives):
            raise ValueError("an image without sub-images")
        return natives, tuple(left_out)

    return read_json(path, parsed, "delete it and cut again")


def _parsed_native(image: Any) -> NativeImage:
    if not 1 <= image["white"] <= 65535:
        raise ValueError(f"white = {image['white']}")
    sub_images = tuple(
        SubImage(
            str(sub["name"]),
            int(sub["row"]),
            int(sub["column"]),
            Rectangle(*map(int, sub["core"])),
            Rectangle(*map(int, sub["stored"])),
        )
        for sub in image["sub_images"]
    )
    return NativeImage(
        str(image["name"]),
        int(image["width"]),
        int(image["height"]),
        sub_images,
        int(image["white"]),
        bool(image["masked"]),
    )
