"""PLY and GLB of a mesh: what others read in them."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from sirpy import mesh_files
from sirpy.errors import InputError, OutputError
from sirpy.mesh_files import VERTEX, fits_glb, read_ply, write_glb, written_mesh


def tetrahedron(path: Path) -> np.ndarray:
    """Written in two pieces, at a place of UTM."""
    vertices = np.zeros(4, VERTEX)
    vertices["x"] = [691000.125, 691010.125, 691000.125, 691000.125]
    vertices["y"] = [5335000, 5335000, 5335010, 5335000]
    vertices["z"] = [500, 500, 500, 507.5]
    vertices["nz"] = 1
    vertices["red"], vertices["green"] = [0, 128, 255, 55], 128
    with written_mesh(path) as writer:
        assert writer.add_vertices(vertices[:3]) == 0
        assert writer.add_faces(np.array([[0, 2, 1]])) == 0
        assert writer.add_vertices(vertices[3:]) == 3
        assert writer.add_faces(np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])) == 1
    return vertices


def test_what_was_written_is_read_here_and_by_trimesh(tmp_path: Path) -> None:
    truth = tetrahedron(tmp_path / "a.ply")
    vertices, triangles = read_ply(tmp_path / "a.ply")
    assert np.array_equal(vertices, truth)
    assert triangles["vertices"].tolist() == [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    found = trimesh.load(tmp_path / "a.ply", process=False)
    assert found.is_watertight and found.volume == pytest.approx(125)
    assert found.vertices[1].tolist() == [691010.125, 5335000, 500]
    assert found.visual.vertex_colors[1].tolist() == [128, 128, 0, 255]
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_nothing_is_there_when_writing_ends_early(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"a\.ply"), written_mesh(tmp_path / "a.ply") as writer:
        writer.add_vertices(np.zeros(3, VERTEX))
        raise OSError(28, "No space left on device")
    assert not list(tmp_path.iterdir())


def test_glb_is_what_trimesh_and_gltf_expect(tmp_path: Path) -> None:
    tetrahedron(tmp_path / "a.ply")
    write_glb(tmp_path / "a.glb", *read_ply(tmp_path / "a.ply"), "EPSG:32632")
    scene = trimesh.load(tmp_path / "a.glb", process=False)
    (mesh,) = scene.geometry.values()
    (node,) = scene.graph.nodes_geometry
    mesh.apply_transform(scene.graph[node][0])  # y is up
    raw = (tmp_path / "a.glb").read_bytes()
    magic, version, length, document_size = struct.unpack("<4sIII", raw[:16])
    document = json.loads(raw[20 : 20 + document_size])
    assert (magic, version, length) == (b"glTF", 2, len(raw))
    place = document["asset"]["extras"]
    assert place == document["nodes"][0]["extras"]
    assert place == {"origin": [691005, 5335005, 504], "crs": "EPSG:32632"}
    world = np.array(place["origin"]) + mesh.vertices[:, [0, 2, 1]] * [1, -1, 1]
    assert world[1].tolist() == [691010.125, 5335000, 500]
    assert mesh.is_watertight and mesh.volume == pytest.approx(125)
    colours = np.asarray(mesh.visual.vertex_attributes["color"])
    assert colours[2, 0] == 1 and colours[0, 0] == 0  # linear, as glTF wants
    assert colours[1] == pytest.approx([0.2158605, 0.2158605, 0], abs=1e-6)
    low, high = (document["accessors"][0][end] for end in ("min", "max"))
    assert low == (-5 + np.array([0.125, 0, 1])).tolist() and high[2] == 3.5
    write_glb(tmp_path / "b.glb", *read_ply(tmp_path / "a.ply"), "EPSG:32632")
    assert (tmp_path / "b.glb").read_bytes() == raw


def test_a_glb_has_an_end() -> None:
    assert fits_glb(50_000_000, 100_000_000) and not fits_glb(80_000_000, 160_000_000)


def test_a_ply_counts_no_further_than_its_indices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mesh_files, "MOST_VERTICES", 10)
    with (
        pytest.raises(InputError, match="--resolution"),
        written_mesh(tmp_path / "a.ply") as writer,
    ):
        writer.add_vertices(np.zeros(11, VERTEX))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("bytes_lost", [1, 13, 60])
def test_half_a_mesh_is_refused(tmp_path: Path, bytes_lost: int) -> None:
    tetrahedron(tmp_path / "a.ply")
    whole = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(whole[:-bytes_lost])
    with pytest.raises(InputError, match=r"a\.ply"):
        read_ply(tmp_path / "a.ply")
