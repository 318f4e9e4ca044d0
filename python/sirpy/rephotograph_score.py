"""How a cloud is compared with photographs, and what is counted."""

from __future__ import annotations

from dataclasses import dataclass

from sirpy.errors import InputError

THRESHOLDS = (0.5, 0.7, 0.9)


@dataclass(frozen=True)
class RephotographOptions:
    """How a cloud is drawn and compared."""

    radius: float = 1.0
    """Half the side of a point's square, pixels of the photograph; with points as far apart as the pixels of
    photographs that were decimated s times, s."""
    shrink: int = 2
    """Both pictures are compared at means of shrink x shrink pixels, which takes out noise and small gaps."""
    min_views: int = 2
    """Photographs of the cloud that must see a pixel, or nothing is asked of it."""

    def __post_init__(self) -> None:
        for name, value, least, most in (
            ("radius", self.radius, 0.5, 64),
            ("shrink", self.shrink, 1, 64),
            ("min-views", self.min_views, 1, 1000),
        ):
            if not least <= value <= most:
                raise InputError(
                    f"--{name} {value:g} is not possible: choose {least:g} to {most:g}"
                )


@dataclass(frozen=True)
class Score:
    """Pixels of a shrunk photograph, or of several: those judged, those of them that show points, those with
    texture, and those of the latter that are alike by each of THRESHOLDS (no point is not alike)."""

    pixels: int = 0
    covered: int = 0
    textured: int = 0
    alike: tuple[int, ...] = (0,) * len(THRESHOLDS)

    def __add__(self, other: Score) -> Score:
        return Score(
            self.pixels + other.pixels,
            self.covered + other.covered,
            self.textured + other.textured,
            tuple(a + b for a, b in zip(self.alike, other.alike, strict=True)),
        )

    def shares(self) -> dict[str, float | None]:
        """covered, right_0.5 ..., of 1; None where there is nothing to judge."""
        right = {
            f"right_{threshold}": alike / self.textured if self.textured else None
            for threshold, alike in zip(THRESHOLDS, self.alike, strict=True)
        }
        return {"covered": self.covered / self.pixels if self.pixels else None, **right}
