"""Rectangles of whole pixels, and the grid that cuts a native image into sub-images.

Pixel (x, y) is column x, row y, from the top-left; a rectangle holds x0 <= x < x0 + width. In the cameras'
coordinates (centre of the top-left pixel at (0.5, 0.5)) recapture is the shift
sub_from_native: (u, v) -> (u - x0, v - y0), exact under every camera model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

from sirpy.errors import InputError


@dataclass(frozen=True, order=True)
class Rectangle:
    """Columns x0 .. x0 + width - 1 and rows y0 .. y0 + height - 1 of an image, in pixels."""

    x0: int
    y0: int
    width: int
    height: int

    @classmethod
    def from_corners(cls, x0: int, y0: int, x1: int, y1: int) -> Rectangle:
        """The rectangle x0 <= x < x1, y0 <= y < y1; empty (zero size) where x1 <= x0 or y1 <= y0."""
        return cls(x0, y0, max(0, x1 - x0), max(0, y1 - y0))

    @property
    def x1(self) -> int:
        return self.x0 + self.width

    @property
    def y1(self) -> int:
        return self.y0 + self.height

    @property
    def area(self) -> int:
        return self.width * self.height

    def as_list(self) -> list[int]:
        """[x0, y0, width, height], as it stands in files."""
        return list(self.as_tuple())

    def as_tuple(self) -> tuple[int, int, int, int]:
        return self.x0, self.y0, self.width, self.height

    def padded(self, margin: int) -> Rectangle:
        """This rectangle with `margin` more pixels on each side."""
        return Rectangle(
            self.x0 - margin, self.y0 - margin, self.width + 2 * margin, self.height + 2 * margin
        )

    def grown(self, width: int, height: int, inside: Rectangle) -> Rectangle:
        """A rectangle of at least that size around this one, moved into `inside`; that large at most."""
        width = min(max(width, self.width), inside.width)
        height = min(max(height, self.height), inside.height)
        x0 = self.x0 - (width - self.width) // 2
        y0 = self.y0 - (height - self.height) // 2
        return Rectangle(
            min(max(x0, inside.x0), inside.x1 - width),
            min(max(y0, inside.y0), inside.y1 - height),
            width,
            height,
        )

    def intersection(self, other: Rectangle) -> Rectangle:
        """The pixels in both; empty (zero area) where there are none."""
        return Rectangle.from_corners(
            max(self.x0, other.x0),
            max(self.y0, other.y0),
            min(self.x1, other.x1),
            min(self.y1, other.y1),
        )

    def contains(self, other: Rectangle) -> bool:
        return (
            self.x0 <= other.x0
            and self.y0 <= other.y0
            and other.x1 <= self.x1
            and other.y1 <= self.y1
        )

    def aligned(self, step: int) -> Rectangle:
        """The smallest rectangle around this one that begins and ends on multiples of `step` pixels."""
        return Rectangle.from_corners(
            self.x0 // step * step,
            self.y0 // step * step,
            -(-self.x1 // step) * step,
            -(-self.y1 // step) * step,
        )

    def halves(self, step: int) -> list[Rectangle]:
        """Two parts of about the same size, across the longer side, the border on a multiple of `step`."""
        if self.width >= self.height:
            x = (self.x0 + self.x1) // 2 // step * step
            corners = (self.x0, self.y0, x, self.y1), (x, self.y0, self.x1, self.y1)
        else:
            y = (self.y0 + self.y1) // 2 // step * step
            corners = (self.x0, self.y0, self.x1, y), (self.x0, y, self.x1, self.y1)
        return [Rectangle.from_corners(*one) for one in corners]

    def slices_in(self, outer: Rectangle) -> tuple[slice, slice]:
        """(rows, columns) of this rectangle in an array that holds the pixels of `outer`."""
        if not outer.contains(self):
            raise ValueError(f"{self} is not inside {outer}")
        y, x = self.y0 - outer.y0, self.x0 - outer.x0
        return slice(y, y + self.height), slice(x, x + self.width)


@dataclass(frozen=True)
class Grid:
    """`columns` x `rows` sub-images (the paper's I x J) that cover every pixel of a rectangle once.

    They are even, sizes differing by at most one pixel, unless cuts are given: the native x (y) where
    the second and every later column (row) begins.
    """

    columns: int
    rows: int
    column_cuts: tuple[int, ...] = ()
    row_cuts: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.columns < 1 or self.rows < 1:
            raise InputError(
                f"a grid of {self.columns}x{self.rows} sub-images is not possible: "
                "columns and rows must be at least 1"
            )
        for what, count, cuts in (
            ("column", self.columns, self.column_cuts),
            ("row", self.rows, self.row_cuts),
        ):
            if any(later <= earlier for earlier, later in pairwise((0, *cuts))):
                raise InputError(
                    f"{what} cuts at {_spoken(cuts)} are not possible: give pixels above 0, "
                    "each greater than the one before"
                )
            if cuts and count != len(cuts) + 1:
                raise InputError(
                    f"{what} cuts at {_spoken(cuts)} make {len(cuts) + 1} {what}s, not {count}: "
                    "give one of the two"
                )

    @classmethod
    def with_cuts(
        cls,
        column_cuts: tuple[int, ...] = (),
        row_cuts: tuple[int, ...] = (),
        *,
        columns: int | None = None,
        rows: int | None = None,
    ) -> Grid:
        """A grid that is cut at the given native pixels; even, of one part if not said otherwise,
        along a side without cuts."""
        return cls(
            columns if columns is not None else len(column_cuts) + 1,
            rows if rows is not None else len(row_cuts) + 1,
            column_cuts,
            row_cuts,
        )

    def __str__(self) -> str:
        return f"{self.columns}x{self.rows}"

    def cores(self, width: int, height: int) -> Iterator[tuple[int, int, Rectangle]]:
        """(row, column, core) of each sub-image of a whole image, as `tiles`."""
        return self.tiles(Rectangle(0, 0, width, height))

    def tiles(self, rectangle: Rectangle) -> Iterator[tuple[int, int, Rectangle]]:
        """(row, column, core) of each sub-image of `rectangle`, row by row.

        Raises:
            InputError: the grid has more columns or rows than the rectangle has pixels, or a cut lies
                outside it.
        """
        if self.columns > rectangle.width or self.rows > rectangle.height:
            raise InputError(
                f"a grid of {self} sub-images is larger than an image of "
                f"{rectangle.width}x{rectangle.height} pixels: use fewer columns or rows"
            )
        xs = _edges("column", rectangle.x0, rectangle.x1, self.columns, self.column_cuts)
        ys = _edges("row", rectangle.y0, rectangle.y1, self.rows, self.row_cuts)
        for row, (y0, y1) in enumerate(pairwise(ys)):
            for column, (x0, x1) in enumerate(pairwise(xs)):
                yield row, column, Rectangle.from_corners(x0, y0, x1, y1)


def _edges(what: str, begin: int, end: int, count: int, cuts: tuple[int, ...]) -> list[int]:
    """Where the parts of begin <= pixel < end begin, and the end."""
    if not cuts:
        return [begin + i * (end - begin) // count for i in range(count + 1)]
    if outside := [cut for cut in cuts if not begin < cut < end]:
        raise InputError(
            f"the {what} cut at {outside[0]} is outside the pixels that are cut, {begin} to {end}: "
            "give one between them"
        )
    return [begin, *cuts, end]


def _spoken(cuts: tuple[int, ...]) -> str:
    return ",".join(str(cut) for cut in cuts)
