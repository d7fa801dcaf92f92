"""Meshes: textures by hand, sampling against areas, odd files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_diagram.assets.mesh import Mesh, bilinear, encode_png, parse_obj, read_obj, read_png, sample, write_obj
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def written(folder: Path, text: str) -> Mesh:
    (folder / "mesh.obj").write_text(text)
    return read_obj(folder / "mesh.obj")


# Textures.


def test_a_texture_is_interpolated_between_the_centres_of_its_texels() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (4, 6, 3), dtype=np.uint8)
    for u, v in rng.uniform(-0.1, 1.1, (200, 2)):
        column, row = min(max(u * 6 - 0.5, 0.0), 5.0), min(max((1 - v) * 4 - 0.5, 0.0), 3.0)
        expected = np.zeros(3)
        for i in range(4):
            for j in range(6):
                expected += max(0.0, 1 - abs(row - i)) * max(0.0, 1 - abs(column - j)) * image[i, j] / 255
        np.testing.assert_allclose(bilinear(image, np.array([[u, v]]))[0], expected, atol=1e-12)


def test_pictures_come_back_as_they_were(tmp_path: Path) -> None:
    image = np.random.default_rng(1).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    (tmp_path / "x.png").write_bytes(encode_png(image))
    np.testing.assert_array_equal(read_png(tmp_path / "x.png"), image)
    with pytest.raises(AssetError, match=r"gone\.png: no such texture image"):
        read_png(tmp_path / "gone.png")


# Files.


def test_polygons_become_fans(tmp_path: Path) -> None:
    mesh = written(tmp_path, "v 0 0 0\nv 2 0 0\nv 3 1 0\nv 1 3 0\nv 0 2 0\nf 1 2 3 4 5\n")
    corners = mesh.vertices[mesh.faces]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert len(mesh.faces) == 3 and (doubled[:, 2] > 0).all()
    x, y = np.array([0, 2, 3, 1, 0.0]), np.array([0, 0, 1, 3, 2.0])
    assert doubled[:, 2].sum() == pytest.approx(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))  # the shoelace
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, 1.0], (5, 1)))


def test_remarks_may_follow_numbers(tmp_path: Path) -> None:
    said = written(tmp_path, SQUARE.replace("\n", " # a corner\n") + "vt 0 0 # of all\nf 1/1 2/1 3/1 4/1 #5\n")
    plain = written(tmp_path, SQUARE + "vt 0 0\nf 1/1 2/1 3/1 4/1\n")
    np.testing.assert_array_equal(said.vertices[said.faces], plain.vertices[plain.faces])


def test_a_corner_counted_back_is_another_one_further_on(tmp_path: Path) -> None:
    lines = "v {0} 0 0\nv {0} 1 0\nv {0} 0 1\nvt 0 {0}\n"
    text = (
        lines.format(0)
        + "f -3/-1 -2/-1 -1/-1\nf 1/1 2/1 3/1\n"
        + lines.format(1)
        + "f -3/-1 -2/-1 -1/1\nf 1/1 5/2 3/1\n"
    )
    (tmp_path / "back.obj").write_text(text)
    corners = parse_obj(tmp_path / "back.obj").corners
    assert corners[..., 0].tolist() == [[0, 1, 2], [0, 1, 2], [3, 4, 5], [0, 4, 2]]
    assert corners[..., 1].tolist() == [[0, 0, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]] and (corners[..., 2] == -1).all()


def test_a_long_file_is_written_as_line_by_line(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    vertices, normals = rng.normal(size=(2, 10_007, 3)) * 10.0 ** rng.integers(-9, 6, (2, 10_007, 1))
    faces = rng.integers(0, len(vertices), (20_011, 3))
    write_obj(
        Mesh(vertices, normals, uv := rng.random((len(vertices), 2)), faces),
        tmp_path / "long.obj",
        np.zeros((2, 2, 3), np.uint8),
    )
    lines = ["mtllib long.mtl", "usemtl surface"]
    lines += ["v {:.6g} {:.6g} {:.6g}".format(*row) for row in vertices] + [
        "vt {:.6g} {:.6g}".format(*row) for row in uv
    ]
    lines += ["vn {:.5g} {:.5g} {:.5g}".format(*row) for row in normals]
    lines += ["f {0}/{0}/{0} {1}/{1}/{1} {2}/{2}/{2}".format(*row) for row in faces + 1]
    assert (tmp_path / "long.obj").read_text().splitlines() == lines


def test_missing_normals_lean_to_the_larger_triangle(tmp_path: Path) -> None:
    """Each vertex has the mean of its triangles' normals, weighed by area."""
    mesh = written(tmp_path, "v 5 6 7\nv 9 6 7\nv 5 7 7\nv 5 6 9\nf 1 2 3\nf 1 3 4\n")
    # Twice their areas: 4 along z, 2 along x.
    shared = np.array([2.0, 0.0, 4.0]) / np.sqrt(20.0)
    expected = {(5, 6, 7): shared, (5, 7, 7): shared, (9, 6, 7): [0, 0, 1.0], (5, 6, 9): [1.0, 0, 0]}
    for vertex, normal in zip(mesh.vertices, mesh.normals, strict=True):
        np.testing.assert_allclose(normal, expected[tuple(vertex)], atol=1e-12)


def test_each_corner_has_its_own_texture_coordinate_and_normal(tmp_path: Path) -> None:
    rows = "vt 0.1 0.2\nvt 0.3 0.4\nvt 0.5 0.6\nvn 0 0 2\nvn 0 1 0\nvn 1 0 0\n"
    mesh = written(tmp_path, SQUARE + rows + "f 1/1/1 2/2/2 3/3/3\nf 1/-3/-3 3/-1/-1 4/-2/-2\n")
    first, second = mesh.faces
    np.testing.assert_allclose(mesh.uv[first], [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    np.testing.assert_allclose(mesh.normals[first], [[0, 0, 1], [0, 1, 0], [1, 0, 0]])
    np.testing.assert_allclose(mesh.vertices[first], [[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    np.testing.assert_allclose(mesh.uv[second], [[0.1, 0.2], [0.5, 0.6], [0.3, 0.4]])
    np.testing.assert_allclose(mesh.normals[second], [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    # Where a corner has no normal, all are computed.
    mixed = written(tmp_path, SQUARE + rows + "f 1//2 2//2 3\n")
    np.testing.assert_allclose(mixed.normals, np.tile([0, 0, 1.0], (3, 1)))


@pytest.mark.parametrize(
    "text",
    [
        *("f 1 2 5\n", "f 1 2 -5\n", "f 0 1 2\n", "f /1 /1 /1\n", "v inf 0 0\nf 1 2 3\n", "v nan 0 0\nf 1 2 3\n"),
        *(
            "vt 0 0\nf 1/1 /1 3/1\n",
            "vt 0 0\nf 1/2 2/1 3/1\n",
            "vt 0 0\nf 1/0 2/1 3/1\n",
            "vt 0 0\nf 1/-2 2/1 3/1\n",
            "f 1/1 2/1 3/1\n",
        ),
        *("vn 0 0 1\nf 1//2 2//1 3//1\n", "vn 0 0 1\nf 1//0 2//1 3//1\n", "f 1//1 2//1 3//1\n"),
    ],
)
def test_faces_without_vertices_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(AssetError, match=r"mesh\.obj: .*a face names"):
        written(tmp_path, SQUARE + text)


def test_other_broken_meshes_are_named(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="no such mesh"):
        read_obj(tmp_path / "none.obj")
    with pytest.raises(AssetError, match="has no triangles"):
        written(tmp_path, SQUARE + "f 1 2\n")
    with pytest.raises(AssetError, match="not a readable OBJ file"):
        written(tmp_path, SQUARE + "f a b c\n")


# Sampling.


def plate() -> Mesh:
    """Three triangles of areas 1 : 2 : 5, each with a normal and a texture coordinate of its own."""
    triangles = np.array(
        [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 1], [2, 0, 1], [0, 1, 1]], [[0, 0, 2], [5, 0, 2], [0, 1, 2]]]
    )
    normals = np.repeat([[0, 0, 1.0], [0, 1.0, 0], [1.0, 0, 0]], 3, axis=0)
    return Mesh(triangles.reshape(-1, 3).astype(float), normals, np.full((9, 2), 0.5), np.arange(9).reshape(3, 3))


def moments(points: Array) -> tuple[Array, Array]:
    return points.mean(axis=0), np.cov(points.T)


def test_each_triangle_has_its_share_of_the_points_spread_evenly() -> None:
    mesh, count = plate(), 4000
    cloud = sample(mesh, np.zeros((2, 2, 3), dtype=np.uint8), count, seed=3)
    for k, share in enumerate((0.125, 0.25, 0.625)):
        on = np.abs(cloud.points[:, 2] - k) < 1e-9
        assert abs(on.sum() - share * count) <= 1
        np.testing.assert_allclose(cloud.normals[on], np.tile(mesh.normals[3 * k], (on.sum(), 1)))
        corners = mesh.vertices[3 * k : 3 * k + 3, :2]
        mean, covariance = moments(cloud.points[on][:, :2])
        # Of an even distribution on a triangle: the centroid, and 1/12 of the scatter of the corners.
        centre = corners.mean(axis=0)
        expected = (corners - centre).T @ (corners - centre) / 12
        np.testing.assert_allclose(mean, centre, atol=4 * np.sqrt(np.diag(expected).max() / on.sum()))
        np.testing.assert_allclose(covariance, expected, atol=0.15 * expected.max())
    # Any beginning is an even sample, too.
    first = np.abs(cloud.points[:400, 2] - 2) < 1e-9
    assert abs(first.mean() - 0.625) < 4 * np.sqrt(0.625 * 0.375 / 400)


def test_a_sample_repeats_and_has_the_colours_of_its_places() -> None:
    triangle = Mesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]),
        np.array([[0, 0, 1.0], [1, 0, 0], [0, 0, 1]]),
        np.array([[0, 0], [1, 0], [0, 1.0]]),
        np.array([[0, 1, 2]]),
    )
    texture = np.random.default_rng(2).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    cloud, again, other = (sample(triangle, texture, 300, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(cloud.points, again.points)
    assert not np.array_equal(cloud.points, other.points)
    np.testing.assert_array_equal(sample(triangle, texture, 300).points, cloud.points)
    np.testing.assert_allclose(cloud.colours, bilinear(texture, cloud.points[:, :2]), atol=1e-12)
    blend = np.stack([cloud.points[:, 0], 0 * cloud.points[:, 0], 1 - cloud.points[:, 0]], axis=1)
    np.testing.assert_allclose(cloud.normals, blend / np.linalg.norm(blend, axis=1, keepdims=True), atol=1e-12)


def test_fewer_points_than_triangles_fall_anywhere() -> None:
    """Ten points on a strip of 500 triangles: which of them are hit depends on the seed."""
    x = np.arange(501.0)
    low, high = (np.stack([x, np.full(501, y), np.zeros(501)], axis=1) for y in (0.0, 1.0))
    vertices, k = np.concatenate([low, high]), np.arange(500)
    up = np.tile([0, 0, 1.0], (len(vertices), 1))
    strip = Mesh(vertices, up, np.zeros((len(vertices), 2)), np.stack([k, k + 1, k + 501], axis=1))
    texture = np.zeros((2, 2, 3), dtype=np.uint8)
    hit = np.sort(np.floor([sample(strip, texture, 10, seed).points[:, 0] for seed in range(200)]), axis=1)
    np.testing.assert_array_equal(hit // 50, np.tile(np.arange(10), (200, 1)))  # one in each tenth
    assert np.std(hit % 50) == pytest.approx(50 / np.sqrt(12), rel=0.1)


def test_a_sheet_with_two_sides_has_the_normals_of_both(tmp_path: Path) -> None:
    """Its vertices have none: those of their triangles cancel."""
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 3 2\n")
    cloud = sample(read_obj(tmp_path / "a.obj"), np.zeros((2, 2, 3), dtype=np.uint8), 50)
    np.testing.assert_array_equal(np.abs(cloud.normals), np.tile([0, 0, 1.0], (50, 1)))
    assert (cloud.normals[:, 2] > 0).sum() == 25
