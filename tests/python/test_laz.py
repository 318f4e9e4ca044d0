"""LAZ files open with the right CRS, places, colours and extra dimensions, and are the same every time."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest
from cloud_parts import UTM, cloud_of, ground
from sirpy.cloud import positions
from sirpy.errors import InputError
from sirpy.frame import Frame
from sirpy.laz import lattice, write_laz


def test_laspy_reads_what_was_fused(tmp_path: Path) -> None:
    cloud = cloud_of(tmp_path, [ground(3000), ground(2000, seed=1)])
    truth = np.concatenate(list(cloud.runs()))
    assert write_laz(tmp_path / "a.laz", cloud, cloud.runs()) == 5000
    found = laspy.read(tmp_path / "a.laz")
    header = found.header
    assert (str(header.version), header.point_format.id, header.point_count) == ("1.4", 7, 5000)
    assert header.global_encoding.wkt and header.parse_crs().to_epsg() == 32632
    assert header.scales.tolist() == [0.001] * 3 and (header.offsets % 1 == 0).all()
    assert np.abs(found.xyz - positions(truth)).max() <= 0.5001e-3
    assert np.allclose([header.mins, header.maxs], [cloud.low, cloud.high], atol=1e-3)
    for name in ("red", "green", "blue"):
        assert np.array_equal(found[name] // 256, truth[name])
        assert np.array_equal(found[name] % 256, truth[name])  # white is 65535
    assert np.array_equal(found["views"], truth["views"])
    for name in ("confidence", "gsd"):
        assert np.allclose(found[name], truth[name], rtol=1 / 2048, atol=0)
    assert set(found.return_number) == set(found.number_of_returns) == {1}


def test_the_same_cloud_gives_the_same_bytes_and_no_date(tmp_path: Path) -> None:
    cloud = cloud_of(tmp_path, [ground(120_000)])
    for name in ("a.laz", "b.laz"):
        write_laz(tmp_path / name, cloud, cloud.runs())
    one = (tmp_path / "a.laz").read_bytes()
    assert one == (tmp_path / "b.laz").read_bytes()
    assert laspy.read(tmp_path / "a.laz").header.creation_date is None


def test_a_local_frame_has_no_crs(tmp_path: Path) -> None:
    cloud = cloud_of(tmp_path, [ground(100)], Frame())
    write_laz(tmp_path / "a.laz", cloud, cloud.runs())
    assert laspy.read(tmp_path / "a.laz").header.parse_crs() is None


def test_a_compound_crs_is_kept(tmp_path: Path) -> None:
    frame = Frame("EPSG:25832+7837", UTM.scale, UTM.rotation, UTM.translation)
    cloud = cloud_of(tmp_path, [ground(100)], frame)
    write_laz(tmp_path / "a.laz", cloud, cloud.runs())
    crs = laspy.read(tmp_path / "a.laz").header.parse_crs()
    assert [part.to_epsg() for part in crs.sub_crs_list] == [25832, 7837]


def test_a_cloud_without_points_is_a_file_without_points(tmp_path: Path) -> None:
    cloud = cloud_of(tmp_path, [ground(0)])
    assert write_laz(tmp_path / "a.laz", cloud, cloud.runs()) == 0
    assert laspy.read(tmp_path / "a.laz").header.point_count == 0


def test_an_unknown_crs_is_said(tmp_path: Path) -> None:
    cloud = cloud_of(tmp_path, [ground(10)], Frame("EPSG:123456"))
    with pytest.raises(InputError, match="EPSG:123456 is not a known CRS"):
        write_laz(tmp_path / "a.laz", cloud, cloud.runs())
    assert not list(tmp_path.glob("*.laz"))


@pytest.mark.parametrize(
    ("gsd", "far", "step"),
    [
        (0.05, 0.0, 1e-3),
        (0.021, 0.0, 1e-3),
        (0.0099, 0.0, 1e-4),
        (3.0, 0.0, 1e-3),
        (0.05, 4e6, 1e-2),
    ],
)
def test_steps_are_powers_of_ten_that_reach_every_point(
    tmp_path: Path, gsd: float, far: float, step: float
) -> None:
    points = ground(50)
    points["gsd"] = gsd
    points["x"][0] += far
    cloud = cloud_of(tmp_path, [points], Frame())
    assert lattice(cloud)[0] == step
    write_laz(tmp_path / "a.laz", cloud, cloud.runs())
    found = laspy.read(tmp_path / "a.laz").xyz
    assert np.abs(found - positions(points)).max() <= 0.5001 * step


_WRITES = """
import resource, sys
from pathlib import Path
from sirpy.cloud import Cloud
from sirpy.frame import Frame
from sirpy.laz import write_laz
cloud = Cloud([Path(sys.argv[1])] * int(sys.argv[2]), Frame())
write_laz(Path(sys.argv[3]), cloud, cloud.runs())
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.skipif(not hasattr(resource, "RUSAGE_SELF"), reason="needs getrusage")
def test_memory_does_not_go_with_the_cloud(tmp_path: Path) -> None:
    cloud_of(tmp_path, [ground(100_000)])
    peaks = []
    for copies in (2, 20):
        command = [sys.executable, "-c", _WRITES, str(tmp_path / "0.npy"), str(copies)]
        done = subprocess.run([*command, str(tmp_path / "a.laz")], capture_output=True, check=True)
        peaks.append(int(done.stdout))
    assert peaks[1] - peaks[0] < 15_000  # kB; the points themselves are 88 MB more
