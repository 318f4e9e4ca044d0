"""Small pictures: encoding of RGB arrays, text, and colours for depths and for reasons."""

from __future__ import annotations

import base64
import warnings
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MISSING_COLOUR = (38, 40, 44)

# Colours of the reasons why pixels have no depth, in the order of their bits.
REASON_COLOURS = (
    "#f0b64a",
    "#c8501e",
    "#8d5aa8",
    "#3f9c85",
    "#9aa4af",
    "#d98bb0",
    "#6f5b45",
    "#b9c246",
)


def encoded_jpeg(image: NDArray[np.uint8], quality: int = 85) -> bytes:
    """A JPEG file of an RGB array (height, width, 3)."""
    return _encoded(image, driver="JPEG", quality=quality)


def encoded_png(image: NDArray[np.uint8]) -> bytes:
    """A PNG file of an RGB array (height, width, 3)."""
    return _encoded(image, driver="PNG")


def data_address(picture: bytes, kind: str) -> str:
    """A picture file of the kind "jpeg" or "png" as an address, which embeds it into a page."""
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode('ascii')}"


def _encoded(image: NDArray[np.uint8], driver: str, **options: object) -> bytes:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.io import MemoryFile

    height, width, channels = image.shape
    # In memory, so that GDAL leaves no side-car files (.aux.xml) beside the picture.
    with (
        warnings.catch_warnings(),
        rasterio.Env(GDAL_PAM_ENABLED=False),
        MemoryFile() as memory,
    ):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with memory.open(
            driver=driver, width=width, height=height, count=channels, dtype="uint8", **options
        ) as file:
            file.write(np.moveaxis(image, -1, 0))
        return bytes(memory.getbuffer())


@dataclass(frozen=True)
class Text:
    """A line of text in a picture: its top is at y, and x at the share `anchor` of its length; `size` is
    its height, in pixels.
    """

    x: int
    y: int
    words: str
    size: int
    most_width: int  # shortened in the middle to fit
    anchor: float = 0.0


def with_texts(
    image: NDArray[np.uint8], texts: Iterable[Text], colour: tuple[int, int, int]
) -> NDArray[np.uint8]:
    """A copy of an RGB array (height, width, 3) with text on it."""
    from PIL import Image, ImageDraw, ImageFont

    canvas = Image.fromarray(image)
    draw = ImageDraw.Draw(canvas)
    for text in texts:
        font = ImageFont.load_default(text.size)
        words = text.words
        kept = len(words)
        while kept > 2 and draw.textlength(words, font) > text.most_width:
            kept -= 1
            words = f"{text.words[: kept // 2]}…{text.words[kept // 2 - kept :]}"
        left = text.x - text.anchor * draw.textlength(words, font)
        draw.text((left, text.y), words, colour, font)
    return np.array(canvas)


def rgb(colour: str) -> tuple[int, int, int]:
    """Of "#rrggbb"."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def depth_colours(depth: NDArray[np.float32], nearest: float, farthest: float) -> NDArray[np.uint8]:
    """RGB (height, width, 3) of a depth map: near is warm, far is cold; missing (<= 0) is dark
    grey.
    """
    position = np.clip((farthest - depth) / max(farthest - nearest, 1e-12), 0, 1)
    # Without the two ends of the map, which are as dark as the missing pixels.
    colours = turbo(0.1 + 0.83 * position)
    colours[~(depth > 0)] = MISSING_COLOUR
    return colours


def turbo(position: NDArray[np.floating]) -> NDArray[np.uint8]:
    """RGB of positions 0 .. 1 on the colour map "turbo" (A. Mikhailov, Google AI blog, 2019).

    The polynomials are those that its author published for shaders.
    """
    powers = np.stack([position**k for k in range(6)], axis=-1)
    colours = powers @ _TURBO.T
    levels: NDArray[np.uint8] = (np.clip(colours, 0, 1) * 255 + 0.5).astype(np.uint8)
    return levels


_TURBO = np.array(
    [
        [0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943],
        [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604],
        [0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973],
    ]
)
