"""What each pair of a registered pose pulls, in units of depth's error at its pixel, compiled; `claims` sums it up."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.cloud_kernels import PairRules, SurfaceCloud, opposite
from twin_diagram.perception.registration.point_kernels import (
    DEEPER,
    DISTANCE,
    FACING,
    MATCHED,
    N_AT,
    LooksFrom,
    NoiseLaw,
    U,
    V,
    Z,
)
from twin_diagram.perception.registration.residual_kernels import screw_row, tukey_weight
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled, compiled_in_place


@compiled
def pulls(
    told: Array,
    flags: npt.NDArray[np.uint8],
    pose: tuple[Array, Array],
    points_W: Array,
    camera: LooksFrom,
    noise: NoiseLaw,
    cloud: SurfaceCloud,
    cuts: tuple[float, float, float],
    rules: PairRules,
    H: Array,
) -> tuple[Array, Array, Array]:
    """Return what depth pulls at a pose (N, 6), and where in the image, u and v (N,) [px].

    Args:
        told: (P, COLUMNS) looked up at the pose.
        flags: (P,).
        pose: R (3, 3), p (3,).
        points_W: (M, 3) image points that were to be explained; none: (0, 3).
        camera: from where.
        noise: of depth.
        cloud: of the model.
        cuts: pairs farther apart were cut [m]; along the sight, so many times that; deviation of the surface [m].
        rules: of the image's points.
        H: (6, 6) normal equations, added to; of the image's points with what slides.
    """
    P, M = told.shape[0], points_W.shape[0]
    a, u, v = np.empty((P + M, 6)), np.empty(P + M), np.empty(P + M)
    n = _of_model(told, flags, noise, cuts, (pose[1], camera.p_WC), (a, u, v), H)
    if M:
        J, w, normal = np.empty((M, 6)), np.empty(M), np.empty((M, 3))
        opposite(points_W, pose, camera.p_WC, cloud, cuts[0], rules, (J, w, normal), (H, np.zeros(6)))
        n = _of_image(points_W, (J, w, normal), camera, noise, n, (a, u, v))
    return a[:n], u[:n], v[:n]


@compiled_in_place
def _of_model(
    told: Array,
    flags: npt.NDArray[np.uint8],
    noise: NoiseLaw,
    cuts: tuple[float, float, float],
    places: tuple[Array, Array],
    filled: tuple[Array, Array, Array],
    H: Array,
) -> int:
    """Fill in what the model's points pull; return how many do. `places`: the object's and the camera's, (3,) each."""
    reach, deepest, model_noise = cuts
    p, p_WC = places
    a, u, v = filled
    n = 0
    for k in range(told.shape[0]):
        row = told[k]
        if not flags[k] & MATCHED or abs(row[DEEPER]) >= deepest * reach:
            continue
        depth = noise.floor + noise.growth * (row[Z] - noise.start) ** 2
        across = depth * max(row[FACING], 0.2)
        w = tukey_weight(row[DISTANCE], reach) / (across * across + model_noise * model_noise)
        if w <= 0.0:
            continue
        screw_row(row[:3], -row[N_AT], -row[N_AT + 1], -row[N_AT + 2], a[n])
        along = 0.0
        for i in range(3):
            along += row[N_AT + i] * (row[i] + p[i] - p_WC[i]) / row[Z]
        _weigh(a[n], w, w * along * depth, H)
        u[n], v[n] = row[U], row[V]
        n += 1
    return n


@compiled_in_place
def _weigh(J: Array, w: float, pull: float, H: Array) -> None:
    """Add w J Jᵀ to H, and turn J (6,) into what noise pulls."""
    for i in range(6):
        for j in range(6):
            H[i, j] += w * J[i] * J[j]
    for i in range(6):
        J[i] *= pull


@compiled_in_place
def _of_image(
    points_W: Array,
    pairs: tuple[Array, Array, Array],
    camera: LooksFrom,
    noise: NoiseLaw,
    n: int,
    filled: tuple[Array, Array, Array],
) -> int:
    """Fill in what the image's points pull, after n others; return how many there are then."""
    J, w, normal = pairs
    a, u, v = filled
    R_WC, p_WC = camera.R_WC, camera.p_WC
    for k in range(points_W.shape[0]):
        if w[k] < 0.0:
            continue
        x, y, z = points_W[k, 0] - p_WC[0], points_W[k, 1] - p_WC[1], points_W[k, 2] - p_WC[2]
        right = R_WC[0, 0] * x + R_WC[1, 0] * y + R_WC[2, 0] * z
        down = R_WC[0, 1] * x + R_WC[1, 1] * y + R_WC[2, 1] * z
        ahead = R_WC[0, 2] * x + R_WC[1, 2] * y + R_WC[2, 2] * z
        near = max(ahead, 1e-6)
        u[n], v[n] = right * (camera.fx / near) + camera.cx, down * (camera.fy / near) + camera.cy
        along = (normal[k, 0] * x + normal[k, 1] * y + normal[k, 2] * z) / ahead
        depth = noise.floor + noise.growth * (ahead - noise.start) ** 2
        for i in range(6):
            a[n, i] = J[k, i] * w[k] * along * depth
        n += 1
    return n


@compiled
def lay(a: Array, u: Array, v: Array, cell: float, margin: int) -> tuple[npt.NDArray[np.float32], Array]:
    """Return an image (h, w, k) of the sums of rows over square cells [px], and what its columns (k,) count in.

    Each column is in units of its largest number: in single precision, of numbers about 1.

    Args:
        a: (N, k).
        u: (N,) where they are [px].
        v: (N,).
        cell: edge of a cell [px].
        margin: empty cells all round.
    """
    size = np.full(a.shape[1], 1e-300)
    left, top, right, bottom = u[0], v[0], u[0], v[0]
    for k in range(u.shape[0]):
        left, right = min(left, u[k]), max(right, u[k])
        top, bottom = min(top, v[k]), max(bottom, v[k])
        for i in range(a.shape[1]):
            size[i] = max(size[i], abs(a[k, i]))
    width, height = int(np.rint((right - left) / cell)) + 1, int(np.rint((bottom - top) / cell)) + 1
    image = np.zeros((height + 2 * margin, width + 2 * margin, a.shape[1]), dtype=np.float32)
    for k in range(u.shape[0]):
        line, column = int(np.rint((v[k] - top) / cell)) + margin, int(np.rint((u[k] - left) / cell)) + margin
        for i in range(a.shape[1]):
            image[line, column, i] += a[k, i] / size[i]
    return image, size
