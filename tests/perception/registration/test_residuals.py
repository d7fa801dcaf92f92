"""The normal equations of registration, added up point by point from the laws that the module states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.registration_bench import FOCAL, HEIGHT, WIDTH, Array, frame, model, poses, view
from tests.registration_kernels import colour_at, linearise, unexplained
from twin_diagram.perception.registration.data_association import Looked, Poses, look
from twin_diagram.perception.registration.point_kernels import COARSE, FINE
from twin_diagram.perception.registration.residuals import brightness, toward, tukey


def weight(x: float, cut: float) -> float:
    """Tukey's."""
    return (1.0 - (x / cut) ** 2) ** 2 if abs(x) < cut else 0.0


def looked_up(level: int) -> Looked:
    return look(model(), frame(), poses(), 40, level)


def geometry(looked: Looked, b: int, reach: float) -> tuple[Array, Array, list[bool], list[float]]:
    """Of one pose: H, b, which points take part, and their noise."""
    H, right, near, noise = np.zeros((6, 6)), np.zeros(6), [], []
    for i in range(looked.z.shape[1]):
        sigma = np.sqrt((0.0008 * looked.z[b, i] ** 2 * max(looked.facing[b, i], 0.2)) ** 2 + 0.0007**2)
        noise.append(sigma)
        near.append(bool(looked.matched[b, i]) and abs(looked.deeper[b, i]) < 2.0 * reach)
        if not near[-1]:
            continue
        w = weight(looked.distance[b, i], reach) / sigma**2
        # The point moves by ω × r + v, and n · (y − x) shrinks by what n sees of it.
        n, r = looked.n[b, i], looked.r[b, i]
        J = np.array([-n @ np.cross(axis, r) for axis in np.eye(3)] + [-n @ axis for axis in np.eye(3)])
        H += w * np.outer(J, J)
        right -= w * J * looked.distance[b, i]
    return H, right, near, noise


@pytest.mark.parametrize("reach", [0.008, 0.02])
def test_geometry_is_point_to_plane_with_tukeys_weights(reach: float) -> None:
    looked = looked_up(FINE)
    found, sigma = linearise(looked, frame(), FINE, reach, 0.0)
    pairs = 0
    for b in range(4):
        H, right, near, noise = geometry(looked, b, reach)
        pairs += sum(near)
        np.testing.assert_allclose(sigma[b], noise)
        np.testing.assert_allclose(found.H[b], H, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(found.b[b], right, rtol=1e-9, atol=1e-6)
    assert pairs > 15


def gains(found: Array, colour: Array, n: Array, w: Array) -> Array:
    """Least squares for g = a + b · n with g c ≈ found, held a little by 0.02 of the total on b."""
    rows, targets = [], []
    for i in range(len(w)):
        for k in range(3):
            rows.append(np.sqrt(w[i]) * colour[i, k] * np.array([1.0, *n[i]]))
            targets.append(np.sqrt(w[i]) * found[i, k])
    total = sum(w[i] * colour[i] @ colour[i] for i in range(len(w))) + 1e-6
    for k, share in enumerate((1e-6, 0.02, 0.02, 0.02)):
        rows.append(np.sqrt(share * total) * np.eye(4)[k])
        targets.append(0.0)
    a = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0]
    return np.clip([a @ [1.0, *normal] for normal in n], 0.1, 2.0)


def test_brightness_is_the_least_squares_fit_and_stays_within_bounds() -> None:
    rng = np.random.default_rng(2081)
    colour, n, w = rng.uniform(0.1, 1.0, (30, 3)), rng.normal(size=(30, 3)), rng.uniform(0.0, 1.0, 30)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    for gain, tilt in ((0.7, 0.2), (3.0, 0.0), (0.02, 0.0), (1.0, 1.5)):
        found = colour * (gain + tilt * n[:, :1])
        got = brightness(found[None], colour[None], n[None], w[None])[0]
        np.testing.assert_allclose(got, gains(found, colour, n, w), rtol=1e-6)
    assert brightness(3.0 * colour[None], colour[None], n[None], w[None]).max() == 2.0
    assert brightness(0.0 * colour[None], colour[None], n[None], w[None]).min() == 0.1


@pytest.mark.parametrize(("level", "cut"), [(FINE, 0.30), (COARSE, 0.45)])
@pytest.mark.parametrize("reach", [0.02, 0.007])
def test_colour_is_the_images_slope_along_the_points_way(level: int, cut: float, reach: float) -> None:
    """Factor λ/(1 − λ) over the noise of a twentieth; points seen aslant or far off take no part."""
    image, looked = frame(), looked_up(level)
    plain, _ = linearise(looked, image, level, reach, 0.0)
    both, _ = linearise(looked, image, level, reach, 0.4)
    seen, du, dv = colour_at(image, looked.u, looked.v, level)
    R_WC, p_part = view().R_WC, 0
    for b in range(4):
        near = geometry(looked, b, reach)[2]
        on = np.array(
            [
                looked.facing[b, i]
                if near[i] and looked.facing[b, i] > 0.25 and abs(looked.distance[b, i]) < max(0.5 * reach, 0.006)
                else 0.0
                for i in range(40)
            ]
        )
        gain = gains(seen[b], looked.colour[b], looked.n[b], on)
        H, right = np.zeros((6, 6)), np.zeros(6)
        for i in np.flatnonzero(on):
            off = seen[b, i] - np.minimum(looked.colour[b, i] * gain[i], 1.0)
            w = on[i] * weight(float(np.linalg.norm(off)), cut)
            p_part += w > 0.0
            # Where the pixel goes when the point moves by ω × r + v.
            slope = np.zeros((3, 6))
            x_C = looked.z[b, i] * np.array(
                [(looked.u[b, i] - (WIDTH - 1) / 2) / FOCAL, (looked.v[b, i] - (HEIGHT - 1) / 2) / FOCAL, 1.0]
            )
            for k, axis in enumerate(np.eye(6)):
                d_C = R_WC.T @ (np.cross(axis[:3], looked.r[b, i]) + axis[3:])
                step_u = FOCAL * (d_C[0] / x_C[2] - x_C[0] * d_C[2] / x_C[2] ** 2)
                step_v = FOCAL * (d_C[1] / x_C[2] - x_C[1] * d_C[2] / x_C[2] ** 2)
                slope[:, k] = du[b, i] * step_u + dv[b, i] * step_v
            H += w * slope.T @ slope
            right -= w * slope.T @ off
        factor = 0.4 / 0.6 / 0.05**2
        np.testing.assert_allclose(both.H[b] - plain.H[b], factor * H, rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(both.b[b] - plain.b[b], factor * right, rtol=1e-5, atol=1e-3)
    assert p_part > 10


def test_a_colour_alone_weighs_a_thousand_times_at_most() -> None:
    looked = looked_up(FINE)
    plain, most, half = (linearise(looked, frame(), FINE, 0.02, share)[0].H for share in (0.0, 1.0, 0.5))
    np.testing.assert_allclose(most - plain, 1000.0 * (half - plain), rtol=1e-6, atol=1e-6)


def test_tukeys_weight() -> None:
    x = np.array([0.0, 0.5, -0.5, 0.999, 1.0, -2.0])
    np.testing.assert_allclose(tukey(2.0 * x, 2.0), [weight(float(v), 1.0) for v in x])


def test_a_prior_pulls_towards_its_goal() -> None:
    rng = np.random.default_rng(2082)
    at = poses()
    goal = Poses(Rotation.from_rotvec(rng.normal(0.0, 0.3, (4, 3))).as_matrix() @ at.R, at.p + rng.normal(size=(4, 3)))
    held = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    found = toward(at, goal, held)
    for b in range(4):
        miss = np.concatenate([Rotation.from_matrix(goal.R[b] @ at.R[b].T).as_rotvec(), goal.p[b] - at.p[b]])
        np.testing.assert_allclose(found.H[b], np.diag(held))
        np.testing.assert_allclose(found.b[b], held * miss, atol=1e-9)
        np.testing.assert_allclose(np.linalg.solve(found.H[b], found.b[b]), miss, atol=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_points_that_nothing_explains_pull_the_model_towards_them(share: float) -> None:
    cloud = model()
    away = np.array([0.7, -1.1, 0.4])  # the object is not at the origin
    at = Poses(poses().R[1:2], poses().p[1:2] + away)
    R, p, p_WC = at.R[0], at.p[0], view().p_WC + away
    rng = np.random.default_rng(2083)
    points = p + 0.06 * rng.normal(size=(80, 3)) / 1.5
    reach = 0.03
    found = unexplained(cloud, points, at, p_WC, reach, share)
    H, right, pulled, slid = np.zeros((6, 6)), np.zeros(6), 0, 0
    for y in points:
        apart = [float(np.linalg.norm(R @ x + p - y)) for x in cloud.points]
        k = int(np.argmin(apart))
        r, n = R @ cloud.points[k], R @ cloud.normals[k]
        if apart[k] >= reach or n @ (p_WC - p - r) <= 0.0:
            continue
        w = weight(apart[k], reach) / (2.0 * 0.0007) ** 2
        e = y - p - r
        along = n @ e
        move = [np.cross(axis, r) for axis in np.eye(3)] + list(np.eye(3))
        J = np.array([-n @ m for m in move])
        H += w * np.outer(J, J)
        right -= w * J * along
        pulled += 1
        tangent = e - along * n
        slide = float(np.linalg.norm(tangent))
        if slide > 0.01:  # the model's own spacing
            pull = tangent * (1.0 - 0.01 / slide)
            block = np.array(move).T
            H += share * w * block.T @ block
            right += share * w * block.T @ pull
            slid += 1
    assert pulled > 15 and slid > 5
    np.testing.assert_allclose(found.H[0], H, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(found.b[0], right, rtol=1e-8, atol=1e-6)
