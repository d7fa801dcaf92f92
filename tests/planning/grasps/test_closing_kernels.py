"""The compiled part of closing, against the same written plainly, and what a proposal works out once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.planning.grasps import PANDA_HAND, closing_kernels, proposal
from twin_diagram.planning.grasps.proposal import Wanted, propose
from twin_diagram.planning.grasps.triangles import laid_out, surface_cloud
from twin_diagram.signals import rotations

Array = npt.NDArray[np.float64]

POSES, ENTRIES, POINTS = 5, 4000, 300
HALF, WIDE, ALONG = 0.012, 0.04, (-0.05, 0.01, -0.008, 0.009)


@pytest.fixture
def drawn() -> dict[str, Array]:
    rng = np.random.default_rng(4)
    normals = rng.standard_normal((POINTS, 3))
    return {
        "pose": np.sort(rng.integers(0, POSES - 1, ENTRIES)),  # the last pose has nothing before it
        "point": rng.integers(0, POINTS, ENTRIES),
        "q": (rng.uniform(-1, 1, (3, ENTRIES)) * [[0.02], [0.06], [0.06]]).astype(np.float32),
        "other": rng.random(ENTRIES) < 0.1,
        "normals": normals / np.linalg.norm(normals, axis=1, keepdims=True),
        "R": rotations.matrix(rotations.exp(rng.standard_normal((POSES, 3)))),
        "offset": rng.uniform(-0.01, 0.01, POSES),
        "depth": rng.uniform(-0.01, 0.01, POSES),
    }


def test_pads_touch_what_the_same_written_plainly_says(drawn: dict[str, Array]) -> None:
    entries = drawn["pose"], drawn["point"], drawn["q"]
    places = np.empty((ENTRIES, 3))
    axes, normals = (one.astype(np.float32).astype(float) for one in (drawn["R"][:, :, 1], drawn["normals"]))
    across = np.zeros((POSES, POINTS))
    for axis, along in zip(axes.T, normals.T, strict=True):  # each product is added with one rounding
        across = (across + np.outer(axis, along)).astype(np.float32).astype(float)
    single = np.ascontiguousarray(axes, dtype=np.float32), normals.astype(np.float32)
    told = (drawn["other"], *single, drawn["offset"], drawn["depth"])
    furthest, beside, sums = closing_kernels.reached(*entries, *told, HALF, WIDE, ALONG, places)
    patch, against = np.full(POSES, 0.004), np.full(POSES, 0.006)
    contact, normal = closing_kernels.touched(*entries, drawn["normals"], places, furthest, against, patch)
    for k in range(POSES):
        mine = (drawn["pose"] == k) & ~drawn["other"] & (np.abs(drawn["q"][0]) <= HALF)
        x, y, z = drawn["q"].astype(float) - np.array([[0.0], [drawn["offset"][k]], [drawn["depth"][k]]])
        mine &= (np.abs(y) <= WIDE) & (z >= ALONG[0]) & (z <= ALONG[1])
        on = mine & (z >= ALONG[2]) & (z <= ALONG[3])
        n = across[k, drawn["point"]]
        assert sums[k] == pytest.approx([on.sum(), (np.expm1(n[on] ** 2) / np.expm1(1.0)).sum()])
        for side, sign in enumerate((1.0, -1.0)):
            assert furthest[k, side] == (sign * y[on]).max(initial=-np.inf)
            assert beside[k, side] == (sign * y[mine & ~on]).max(initial=-np.inf)
            if not on.any():
                continue
            seen = np.maximum(sign * n, 1e-6)
            deep, at = on & (sign * y >= furthest[k, side] - 0.006), on & (sign * y >= furthest[k, side] - 0.004)
            middle = (seen * np.array([x, y, z]))[:, deep].sum(axis=1) / seen[deep].sum()
            assert contact[k, side] == pytest.approx(middle, abs=1e-9)
            mean = seen[at] @ drawn["normals"][drawn["point"][at]] / seen[at].sum()
            assert normal[k, side] == pytest.approx(mean, abs=1e-9)
    assert not sums[-1].any() and not contact[-1].any()


def test_what_fingers_meet_and_what_is_between_them_is_what_the_same_written_plainly_says(
    drawn: dict[str, Array],
) -> None:
    pose, q, other, offset = (drawn[name] for name in ("pose", "q", "other", "offset"))
    before = closing_kernels.nearest_before(pose, q, offset, other, 0.04, 0.05, HALF)
    ends = closing_kernels.ends_between(pose, q, offset, other, WIDE, HALF)
    for k in range(POSES):
        mine = (pose == k) & (np.abs(q[0]) <= HALF)
        aside = np.abs(q[1] - offset[k])
        meets = mine & (other | (aside >= 0.04)) & (aside <= 0.05)
        between = mine & ~other & (aside <= WIDE)
        assert before[k] == q[2, meets].min(initial=np.inf)
        assert ends[k].tolist() == [q[2, between].min(initial=np.inf), q[2, between].max(initial=-np.inf)]


def bowl(across: float, wall: float = 0.004, sides: int = 48) -> Array:
    """Return the triangles (F, 3, 3) of half a hollow ball."""
    down = np.linspace(0.0, np.pi / 2, 12)
    profile = [
        (r * np.sin(a), across / 2 - r * np.cos(a))
        for r, turn in ((across / 2, 1), (across / 2 - wall, -1))
        for a in down[::turn]
    ]
    around = np.linspace(0.0, 2 * np.pi, sides + 1)
    ring = np.array([[(r * np.cos(t), r * np.sin(t), z) for t in around] for r, z in profile])
    a, b, c, d = ring[:-1, :-1], ring[:-1, 1:], ring[1:, 1:], ring[1:, :-1]
    faces = np.concatenate([np.stack(three, axis=2).reshape(-1, 3, 3) for three in ((a, b, c), (a, c, d))])
    area = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1)
    return faces[area > 1e-12]


def test_a_mesh_is_laid_out_once_a_proposal_and_its_cloud_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bowl is sampled anew twice and more; each batch of candidates had made all of it anew."""
    triangles, made, closer = bowl(0.16), [], []
    looked = proposal._looked_closer
    monkeypatch.setattr(proposal, "surface_cloud", lambda *given: made.append(given[1]) or surface_cloud(*given))
    monkeypatch.setattr(proposal, "laid_out", lambda given: made.append("laid out") or laid_out(given))
    monkeypatch.setattr(proposal, "_looked_closer", lambda *given: closer.append(0) or looked(*given))
    found = propose(*surface_cloud(triangles, 3000, 0), PANDA_HAND, wanted=Wanted(10, 0, triangles=triangles))
    assert len(found) >= 4 and len(closer) > 2
    assert len(made) == len(set(made)), made
