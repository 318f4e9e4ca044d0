"""What is known of the photographs before any is decoded: who shares a camera, where they were
taken, which rig they belong to, and what follows for matching."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sirpy.errors import InputError
from sirpy.exif import Exif, read_exif
from sirpy.initial_cameras import Size, lens_groups
from sirpy.pairing import ALL_PAIRS, NEIGHBOURS, chosen_matcher
from sirpy.rigs import Place, Rig, places, read_rigs
from sirpy.sfm_options import Matcher, SfmOptions

_MOST = 0.5  # of the photographs have a position where positions are to be used


@dataclass(frozen=True)
class SurveyPhotograph:
    """`decimated`: name of the decimated copy; photographs of equal `camera` share one;
    `position`: latitude and longitude in degrees, altitude in m."""

    decimated: str
    camera: int
    has_exif: bool
    position: tuple[float, float, float | None] | None


@dataclass(frozen=True)
class Survey:
    """`matcher`: never auto; `notes`: what was chosen, for the user."""

    photographs: dict[str, SurveyPhotograph]
    rigs: tuple[Rig, ...]
    matcher: Matcher
    notes: list[str]


def look_at(images: Path, sizes: Mapping[str, Size], options: SfmOptions) -> Survey:
    """What the headers of the photographs tell.

    Args:
        sizes: (width, height) of each photograph in native pixels.

    Raises:
        InputError: the photographs do not have what the options ask for.
    """
    exifs = {name: read_exif(images / name) for name in sizes}
    rigs = read_rigs(options.rig) if options.rig is not None else ()
    of_rigs = places(rigs, sizes)
    positions = {name: _position(exif, options) for name, exif in exifs.items()}
    cameras = {
        name: camera
        for camera, group in enumerate(_groups(sizes, exifs, of_rigs, options))
        for name in group
    }
    photographs = {
        name: SurveyPhotograph(
            # Numbers, since COLMAP's list of pairs cannot hold names with spaces.
            f"{of_rigs[name].prefix}{of_rigs[name].exposure:06d}.jpg"
            if name in of_rigs
            else f"{index:06d}.jpg",
            cameras[name],
            bool(exifs[name].lens),
            positions[name],
        )
        for index, name in enumerate(sizes)
    }
    missing = [name for name, position in positions.items() if position is None]
    _check_gps(images, len(sizes), missing, options)
    matcher = chosen_matcher(options.matcher, [p and (p[0], p[1]) for p in positions.values()])
    return Survey(photographs, rigs, matcher, _notes(matcher, options, len(sizes), missing))


def _position(exif: Exif, options: SfmOptions) -> tuple[float, float, float | None] | None:
    if exif.position is None or options.gps == "off":
        return None
    return (*exif.position, exif.altitude)


def _groups(
    sizes: Mapping[str, Size],
    exifs: Mapping[str, Exif],
    of_rigs: Mapping[str, Place],
    options: SfmOptions,
) -> list[list[str]]:
    """Photographs that share a camera: in a rig, those of one prefix."""
    prefixes = sorted({place.prefix for place in of_rigs.values()})
    groups = []
    for prefix in prefixes:
        group = [name for name, place in of_rigs.items() if place.prefix == prefix]
        other = next((name for name in group if sizes[name] != sizes[group[0]]), None)
        if other is not None:
            raise InputError(
                f"{group[0]} and {other} are of one camera of the rig and differ in size: "
                "give each size a camera, or leave one of them out"
            )
        groups.append(group)
    single = {name: size for name, size in sizes.items() if name not in of_rigs}
    return groups + lens_groups(single, exifs, options.camera_per)


def _check_gps(images: Path, count: int, missing: list[str], options: SfmOptions) -> None:
    if options.matcher == "spatial" and missing:
        raise InputError(
            f"matcher = 'spatial' needs a GPS position of every photograph, and {len(missing)} of "
            f"the {count} in {images} have none in EXIF ({missing[0]}): choose auto or sequential"
        )
    if options.gps == "use" and count - len(missing) < max(3, _MOST * count):
        raise InputError(
            f"gps = 'use' needs GPS positions of three photographs and of half of them at least, and "
            f"{count - len(missing)} of the {count} in {images} have one in EXIF: choose auto"
        )
    if options.gps == "use" and options.mapper == "global":
        raise InputError(
            "gps = 'use' belongs to the incremental mapper, the global one takes no positions: "
            "choose one of the two"
        )


def _notes(matcher: Matcher, options: SfmOptions, count: int, missing: list[str]) -> list[str]:
    """Why pairs were chosen as they are, where that is a choice."""
    if count <= ALL_PAIRS or options.matcher != "auto":
        return []
    if matcher == "spatial":
        return [f"each of the {count} photographs is matched with its {NEIGHBOURS} nearest by GPS"]
    return [
        f"{len(missing)} of the {count} photographs have no GPS position, so each is matched with "
        f"its neighbours by name and the {NEIGHBOURS} that look most like it"
    ]
