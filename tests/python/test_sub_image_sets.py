"""Sub-images of one size, and only those with points."""

from __future__ import annotations

from pathlib import Path

import pycolmap
import pytest
from engine_scenes import Notes
from hypothesis import given
from hypothesis import strategies as st
from sirpy.cutting import cut
from sirpy.errors import InputError
from sirpy.native_images import NativeImage, SubImage
from sirpy.rectangle import Grid
from sirpy.sub_image_sets import of_one_size
from sirpy.windows import read_window
from sub_image_scenes import HEIGHT, WIDTH, camera, model_of, noise, write_image


@given(
    grid=st.tuples(st.integers(1, 7), st.integers(1, 7)),
    overlap=st.integers(0, 30),
    multiple=st.sampled_from([1, 8, 32]),
    sizes=st.lists(st.tuples(st.integers(7, 200), st.integers(7, 200)), min_size=1, max_size=3),
)
def test_sub_images_of_one_size_hold_what_they_held(
    grid: tuple[int, int], overlap: int, multiple: int, sizes: list[tuple[int, int]]
) -> None:
    natives = []
    for width, height in sizes:
        whole = NativeImage("", width, height, ())
        subs = tuple(
            SubImage("", row, column, core, core.padded(overlap).intersection(whole.rectangle))
            for row, column, core in Grid(*grid).cores(width, height)
        )
        natives.append(NativeImage("", width, height, subs))
    before = [sub.stored for native in natives for sub in native.sub_images]
    largest = [max(one.width for one in before), max(one.height for one in before)]
    wanted = [-(-side // multiple) * multiple for side in largest]
    for old, new in zip(natives, of_one_size(natives, multiple), strict=True):
        size = min(wanted[0], old.width), min(wanted[1], old.height)
        for one, other in zip(old.sub_images, new.sub_images, strict=True):
            assert (other.stored.width, other.stored.height) == size
            assert other.core == one.core
            assert other.stored.contains(one.stored)
            assert new.rectangle.contains(other.stored)


def test_sub_images_with_few_points_are_left_out_and_named(tmp_path: Path) -> None:
    photos, names = tmp_path / "photos", ["a.png", "b.png", "c.png"]
    for name in names:
        write_image(photos / name, noise((HEIGHT, WIDTH, 3)))
    model = model_of(names, [camera("PINHOLE")] * 3)
    everything = cut(photos, model, tmp_path / "all", identity="", grid=Grid(3, 3))
    full = pycolmap.Reconstruction(everything.sparse)
    seen = {full.image(i).name: full.image(i).num_points3D for i in full.reg_image_ids()}
    least = sorted(seen.values())[5]
    notes = Notes()
    some = cut(
        photos,
        model,
        tmp_path / "some",
        identity="",
        grid=Grid(3, 3),
        min_points=least,
        progress=notes,
    )
    expected = sorted(name for name, n in seen.items() if n >= least)
    assert len(expected) < len(seen)
    assert sorted(sub.name for _, sub in some.sub_images()) == expected
    assert sorted(path.name for path in some.images.iterdir()) == expected
    kept = pycolmap.Reconstruction(some.sparse)
    assert sorted(kept.image(i).name for i in kept.reg_image_ids()) == expected
    dropped = sorted(seen.keys() - set(expected))
    # What nobody owns is black.
    for full_native, native in zip(everything.natives, some.natives, strict=True):
        for sub in full_native.sub_images:
            if sub.name in dropped:
                assert not read_window(some, native.name, sub.core).any()
    (note,) = [text for text in notes.notes if "fewer than" in text]
    assert note.startswith(f"{len(dropped)} sub-images see fewer than {least} sparse points")
    assert dropped[0] in note
    with pytest.raises(InputError, match="no sub-image sees 1000 sparse points"):
        cut(photos, model, tmp_path / "none", identity="", grid=Grid(3, 3), min_points=1000)
