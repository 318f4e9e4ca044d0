"""Which sub-images are cut, and how large their files are: of one size, only those with sparse points."""

from __future__ import annotations

from dataclasses import replace

from sirpy.errors import InputError
from sirpy.native_images import NativeImage
from sirpy.native_scene import NativeScene
from sirpy.view_fields import points_seen


def of_one_size(natives: list[NativeImage], multiple: int) -> list[NativeImage]:
    """The native images with stored rectangles of one size, a multiple of `multiple` pixels.

    The smallest such size that holds every stored rectangle; where a native image is smaller, its side.
    """
    stored = [sub.stored for native in natives for sub in native.sub_images]
    width = -(-max(one.width for one in stored) // multiple) * multiple
    height = -(-max(one.height for one in stored) // multiple) * multiple
    return [
        replace(
            native,
            sub_images=tuple(
                replace(sub, stored=sub.stored.grown(width, height, native.rectangle))
                for sub in native.sub_images
            ),
        )
        for native in natives
    ]


def with_points(
    natives: list[NativeImage], scene: NativeScene, min_points: int
) -> tuple[list[NativeImage], list[str]]:
    """The native images without the sub-images that see fewer sparse points, and the names of those.

    A native image of which nothing is left is left out.

    Raises:
        InputError: nothing is left.
    """
    kept: list[NativeImage] = []
    dropped: list[str] = []
    for native in natives:
        enough = [
            sub
            for sub in native.sub_images
            if points_seen(scene, native.name, sub.stored) >= min_points
        ]
        dropped += [sub.name for sub in native.sub_images if sub not in enough]
        if enough:
            kept.append(replace(native, sub_images=tuple(enough)))
    if not kept:
        raise InputError(
            f"no sub-image sees {min_points} sparse points: ask for fewer, or for larger sub-images"
        )
    return kept, dropped
