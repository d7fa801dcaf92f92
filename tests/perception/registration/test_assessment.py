"""How well a pose explains an image, counted point by point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.registration_bench import frame, model, poses
from tests.registration_kernels import colour_at
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.data_association import look
from twin_diagram.perception.registration.point_kernels import COARSE, FINE
from twin_diagram.perception.registration.residuals import brightness


@pytest.mark.parametrize(("level", "slack", "light"), [(FINE, 0.003, 1.0), (COARSE, 0.008, 1.0), (FINE, 0.003, 0.25)])
def test_shares_are_counted_as_they_are_described(level: int, slack: float, light: float) -> None:
    image, cloud = replace(frame(), colours=tuple(np.float32(light) * c for c in frame().colours)), model()
    given = {} if slack == 0.003 else {"slack": slack}
    fit = assess(cloud, image, poses(), 40, level, **given)
    looked = look(cloud, image, poses(), 40, level)
    seen, _, _ = colour_at(image, looked.u, looked.v, level)
    kinds = np.zeros(5, dtype=int)
    for b in range(4):
        place = np.zeros(40, dtype=bool)
        for i in range(40):
            sigma = np.sqrt((0.0008 * looked.z[b, i] ** 2) ** 2 + 0.0007**2)
            within = abs(looked.distance[b, i]) < slack + 3.0 * sigma and abs(looked.deeper[b, i]) < 0.03
            place[i] = looked.near[b, i] and within
        weight = looked.facing[b] * place
        gain = brightness(seen[b : b + 1], looked.colour[b : b + 1], looked.n[b : b + 1], weight[None])[0]
        fits = likeness = explained = behind = lost = whole = 0.0
        points = 0
        for i in range(40):
            facing = looked.facing[b, i]
            off = seen[b, i] - np.minimum(looked.colour[b, i] * gain[i], 1.0)
            # In proportion to the light, but for the dark.
            size = float(np.linalg.norm(off)) / max(gain[i], 0.2)
            alike = size < 0.30
            hidden = looked.seen[b, i] and not place[i] and looked.deeper[b, i] < 0.0
            if place[i]:
                explained += facing
                fits += facing * alike
                likeness += facing * (1.0 - (size / 0.30) ** 2) ** 2 * alike
                points += alike
            elif looked.seen[b, i] and not hidden:
                behind += facing
            if facing > 0.1 and (hidden or looked.robot[b, i]):
                lost += facing
            if facing > 0.1 and looked.counted[b, i]:
                whole += facing
            kinds += [place[i], alike and place[i], hidden, looked.robot[b, i], looked.seen[b, i] and not place[i]]
        # Of what faces the camera; where the image is silent about most of it, of all that should.
        known = explained + behind + lost
        share = (explained + behind) / (known if known > 0.3 * whole else whole)
        assert fit.quality[b] == pytest.approx(fits / max(explained + behind, 1e-9))
        assert fit.shape[b] == pytest.approx(explained / max(explained + behind, 1e-9))
        assert fit.likeness[b] == pytest.approx(likeness / max(explained + behind, 1e-9))
        assert fit.visible_share[b] == pytest.approx(share)
        assert fit.points[b] == points
    assert kinds.all(), f"the image is to show all kinds: {kinds}"


def test_where_the_image_is_silent_little_is_visible() -> None:
    """What is known of less than three tenths of an object is a share of all of it."""
    cloud, image = model(), frame()
    looked = look(cloud, image, poses(), 40, FINE)
    b = 0
    facing = looked.facing[b] * (looked.facing[b] > 0.1) * looked.counted[b]
    row, column = np.rint(looked.v[b]).astype(int), np.rint(looked.u[b]).astype(int)
    shares = []
    for few in range(1, 12):
        depth = np.zeros_like(image.depth)
        chosen = np.flatnonzero(facing > 0.0)[:few]
        depth[row[chosen], column[chosen]] = looked.z[b, chosen]
        bare = replace(image, depth=depth, robot=np.zeros_like(image.robot))
        found = look(cloud, bare, poses(), 40, FINE)
        fit = assess(cloud, bare, poses(), 40)
        known = (facing * found.seen[b]).sum() / facing.sum()
        hidden = (facing * (found.seen[b] & ~found.near[b] & (found.deeper[b] < 0.0))).sum() / facing.sum()
        wanted = known - hidden if known <= 0.3 else (known - hidden) / known
        assert fit.visible_share[b] == pytest.approx(wanted), (few, known)
        shares.append(known)
    assert min(shares) < 0.25 and 0.3 < max(shares)


def test_a_pose_off_the_image_fits_nothing() -> None:
    away = poses()
    fit = assess(model(), frame(), type(away)(away.R, away.p + [0.0, 5.0, 0.0]), 40)
    for part in (fit.quality, fit.likeness, fit.visible_share, fit.points):
        np.testing.assert_array_equal(part, 0.0)
