"""What a wrong calibration does to points and poses, against the same done with exact maths."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from twin_diagram.signals.calibration_error import CalibrationError, point_shifts, shared_covariances

R_WC = Rotation.from_euler("xyz", [2.4, 0.2, 1.1]).as_matrix()
P_WC = np.array([1.2, -0.3, 0.8])
FX, FY, CX, CY = 600.0, 590.0, 320.0, 240.0


def believed(points_C: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Points in W as one believes who does not know of the errors; those of a true camera that has them."""
    turn, shift, (scale, focal, du, dv) = errors[:3], errors[3:6], errors[6:]
    R_true, p_true = Rotation.from_rotvec(turn).as_matrix() @ R_WC, P_WC + shift
    p_W = points_C @ R_WC.T + P_WC
    seen = (p_W - p_true) @ R_true
    u = seen[:, 0] / seen[:, 2] * FX * (1.0 + focal) + CX + du
    v = seen[:, 1] / seen[:, 2] * FY * (1.0 + focal) + CY + dv
    z = seen[:, 2] * (1.0 + scale)
    shown = np.column_stack([(u - CX) / FX * z, (v - CY) / FY * z, z])
    return np.asarray(shown @ R_WC.T + P_WC)


def test_points_are_shown_aside_as_the_derivative_says() -> None:
    points = np.random.default_rng(3).uniform([-0.4, -0.3, 0.6], [0.4, 0.3, 1.5], (20, 3))
    J = point_shifts(points, R_WC, FX, FY)
    for k in range(10):
        step = np.zeros(10)
        step[k] = 1e-6 if k < 8 else 1e-3
        moved = (believed(points, step) - believed(points, -step)) / (2 * step[k])
        np.testing.assert_allclose(J[:, :, k], moved, atol=1e-7, err_msg=str(k))


def test_what_all_objects_share_is_in_their_covariance() -> None:
    error = CalibrationError(shift=0.005, turn=0.009, focal=0.003, centre=1.0, depth_scale=0.01)
    np.testing.assert_allclose(
        error.variances, [0.009**2 / 3] * 3 + [0.005**2 / 3] * 3 + [1e-4, 9e-6, 0.5, 0.5], rtol=1e-12
    )
    points = np.array([[0.1, -0.05, 0.9], [-0.3, 0.1, 1.4]])
    rng = np.random.default_rng(4)
    draws = rng.standard_normal((40000, 10)) * np.sqrt(error.variances)
    shifts = np.einsum("nij,kj->nki", point_shifts(points, R_WC, FX, FY), draws)
    found = shared_covariances(error, points, R_WC, FX, FY)
    for k in range(2):
        scatter = np.cov(np.column_stack([-draws[:, :3], shifts[k]]).T)
        deviations = np.sqrt(np.diag(scatter))
        np.testing.assert_allclose(
            found[k] / np.outer(deviations, deviations), scatter / np.outer(deviations, deviations), atol=0.03
        )
    assert not CalibrationError().variances.any()
