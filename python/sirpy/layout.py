"""The layout: which rectangles of an undistorted native image become sub-images.

A grid tiles the image, or a region of interest in it; an area on the ground keeps the sub-images that see it.
Every pixel of the region has one owner. Rectangles are in whole pixels of the undistorted native image, from its
top-left pixel.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from sirpy.area import Area, read_area
from sirpy.errors import InputError
from sirpy.native_images import NativeImage, SubImage
from sirpy.rectangle import Grid, Rectangle


@dataclass(frozen=True)
class Region:
    """What of the native images is cut; all of it by default."""

    roi: Rectangle | None = None
    """Of every image that `rois` does not name; None for the whole image."""
    rois: Mapping[str, Rectangle] = field(default_factory=dict)
    """Of single images, by their names in the model."""
    area: Area | None = None
    """Only the sub-images that see it (`AreaFilter`)."""

    def roi_of(self, name: str) -> Rectangle | None:
        """Of one image; None for all of it."""
        return self.rois.get(name, self.roi)


@dataclass(frozen=True)
class Layout:
    """Grid, overlap (pixels on each side of a sub-image, within the region) and region."""

    grid: Grid
    overlap: int = 0
    region: Region = Region()

    def __post_init__(self) -> None:
        if self.overlap < 0:
            raise InputError(
                f"overlap = {self.overlap} is not possible: it must be at least 0 pixels"
            )

    def check_names(self, names: Iterable[str]) -> None:
        """Raises InputError where the region names an image that is not among `names`."""
        if unknown := sorted(set(self.region.rois) - set(names)):
            raise InputError(
                f"a region is given for {unknown[0]}, which is not among the images of the model that "
                "are cut: give names as they are in the model"
            )

    def native_image(self, name: str, size: tuple[int, int]) -> NativeImage:
        """A native image of `size` (width, height) with all sub-images of its region, not yet named.

        Raises:
            InputError: the region reaches outside the image, or the grid does not fit into it.
        """
        whole = Rectangle(0, 0, *size)
        roi = self.region.roi_of(name) or whole
        if roi.area == 0 or not whole.contains(roi):
            raise InputError(
                f"the region {_written(roi)} reaches outside the undistorted image of {name}, which has "
                f"{size[0]}x{size[1]} pixels: give X0,Y0,WIDTH,HEIGHT inside it"
            )
        try:
            tiles = list(self.grid.tiles(roi))
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        sub_images = tuple(
            SubImage("", row, column, core, core.padded(self.overlap).intersection(roi))
            for row, column, core in tiles
        )
        return NativeImage(name, *size, sub_images)

    def named(self, native: NativeImage, stem: str, extension: str) -> NativeImage:
        """`native` with the names of its sub-images' files, STEM_rRR_cCC.EXTENSION."""
        rows, columns = (
            max(2, len(str(count - 1))) for count in (self.grid.rows, self.grid.columns)
        )
        sub_images = tuple(
            replace(sub, name=f"{stem}_r{sub.row:0{rows}}_c{sub.column:0{columns}}.{extension}")
            for sub in native.sub_images
        )
        return replace(native, sub_images=sub_images)


def read_region(
    roi: str | None = None,
    roi_list: Path | None = None,
    area: Path | None = None,
    area_crs: str | None = None,
    model_crs: str | None = None,
) -> Region:
    """The region that the options of a command line give.

    Args:
        roi: X0,Y0,WIDTH,HEIGHT.
        roi_list: file of lines NAME X0,Y0,WIDTH,HEIGHT; the images that it does not name have `roi`.
        area, area_crs, model_crs: as in `read_area`.

    Raises:
        InputError: one of them cannot be understood.
    """
    if area is None and (area_crs or model_crs):
        raise InputError("--area_crs and --model_crs say where an area is: give --area too")
    return Region(
        _parsed(roi, "--roi") if roi is not None else None,
        _read_rois(roi_list) if roi_list is not None else {},
        read_area(area, area_crs=area_crs, model_crs=model_crs) if area is not None else None,
    )


def parse_cuts(text: str | None, option: str) -> tuple[int, ...]:
    """Pixels of "3000,8000"; none of None. Raises InputError where it is something else."""
    if text is None:
        return ()
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f'{option} "{text}" is not a list of pixels: write it like 3000,8000'
        ) from None


def _read_rois(path: Path) -> dict[str, Rectangle]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"the list of regions {path} cannot be read ({error})") from None
    rois: dict[str, Rectangle] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        *names, rectangle = line.strip().rsplit(None, 1)  # a name may hold blanks
        name = names[0] if names else ""
        if not name or name in rois:
            what = f"names {name} twice" if name else "has no name"
            raise InputError(
                f"{path}, line {number}, {what}: write NAME X0,Y0,WIDTH,HEIGHT, one image a line"
            )
        rois[name] = _parsed(rectangle, f"{path}, line {number}:")
    if not rois:
        raise InputError(
            f"the list of regions {path} is empty: write NAME X0,Y0,WIDTH,HEIGHT, one image a line"
        )
    return rois


def _parsed(text: str, where: str) -> Rectangle:
    try:
        x0, y0, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f'{where} "{text}" is no region: write X0,Y0,WIDTH,HEIGHT in whole pixels of the '
            "undistorted image"
        ) from None
    if min(x0, y0) < 0 or min(width, height) < 1:
        raise InputError(
            f'{where} "{text}" is no region: X0 and Y0 are at least 0, WIDTH and HEIGHT at least 1'
        )
    return Rectangle(x0, y0, width, height)


def _written(rectangle: Rectangle) -> str:
    return ",".join(str(number) for number in rectangle.as_list())
