"""Registers a known object to an RGB-D image: pose, covariance, and how well it fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.perception.registration.assessment import judge, residual_excess
from twin_diagram.perception.registration.claims import TUNING as CLAIMS
from twin_diagram.perception.registration.claims import claim
from twin_diagram.perception.registration.cloud_kernels import within
from twin_diagram.perception.registration.colour_shift import ShiftEvidence
from twin_diagram.perception.registration.data_association import TUNING as LOOKING
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming import Naming
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.refinement_kernels import (
    ImageTerms,
    Rules,
    StepBound,
    StepCourse,
    StepSizes,
    refine_poses,
)
from twin_diagram.perception.registration.residuals import pair_rules, term_rules
from twin_diagram.perception.registration.silhouette import TUNING as SILHOUETTE
from twin_diagram.perception.registration.silhouette import Silhouette
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout


@dataclass(frozen=True)
class Tuning:
    """Constants of Gauss-Newton, chosen by hand; `sims/closed_loop.py --seeds 20` shows their effect."""

    narrow: float = 0.007
    """Reach of the last iterations [m]."""

    coarse_steps: int = 4
    """At most so many iterations on coarse colours; fewer where the steps become small."""

    small_step: tuple[float, float] = (1e-3, 2e-4)
    """After a step smaller than this the next would be lost in the noise [rad], [m]."""

    least_gain: float = 0.15
    """After a step that makes the pose likelier by less [nat], what is left is a third of what white noise of the image
    does, and less of any other."""

    fine_from: tuple[float, float] = (0.03, 0.004)
    """After a step smaller than this colours are fine [rad], [m]."""

    right: tuple[float, float] = (0.01, 0.002)
    """A prediction was right that is no farther off on coarse colours: it needs no wide reach [rad], [m]."""

    in_place: float = 0.9
    """What was expected to be right and of which less than this share of what is seen fits is searched wider, …"""

    coloured: float = 0.8
    """… or of which less than this share of what fits in shape fits in colour, too."""

    led_away: float = 1.1
    """Where the start looks so many times more like the object than what came of it, coarse colours led away: of 40
    half hidden cans, registered from the truth, six by 8 to 46 degrees."""

    largest_step: tuple[float, float] = (0.3, 1.5)
    """A longer step is cut: look-ups cannot know [rad], [reaches]."""

    widest: tuple[float, ...] = CLAIMS.widest
    """Standard deviations where the image says nothing [rad], [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class RegisteredPose:
    """What registration found.

    Attributes:
        R: (3, 3) rotation R_WO.
        p: (3,) position p_WO [m].
        covariance: (6, 6): rotation, translation; left perturbation in W about the object's origin.
        quality: share of the visible surface that fits, 0 to 1; see `assessment.PoseFit`.
        likeness: the same, each point counted by how near its colour comes.
        visible_share: share of the surface facing the camera that nothing hides.
        points: number of model points that fit.
        shape: quality without regard to colours.
        evidence: what its colours say of their shift beside depth; None where that is certain.
        odds: logarithm of the odds that it is not one of its turns that leave the shape alike; None: nobody looked.
        alone: the same before it was taken into account that the object stands; None: it was not.
        named: how sure it is that it is this object; None: nobody asked.
        by_shape: it was told by shape alone; None: as it was before.
    """

    R: Array
    p: Array
    covariance: Array
    quality: float
    likeness: float
    visible_share: float
    points: float
    shape: float = 0.0
    evidence: ShiftEvidence | None = None
    odds: float | None = None
    alone: RegisteredPose | None = None
    named: Naming | None = None
    by_shape: bool | None = None


def information(rotation: float, translation: float) -> Array:
    """Return prior information (6,) from standard deviations [rad], [m]."""
    return np.repeat([rotation**-2, translation**-2], 3)


def refine(
    model: ModelCloud,
    frame: Frame,
    start: Poses,
    count: int,
    iterations: int,
    prior: Array,
    params: scenario.Registration,
    *,
    coarse_only: bool = False,
    fine_only: bool = False,
    right: bool = False,
    points_W: Array | None = None,
) -> Poses:
    """Refine starts by Gauss-Newton, each by itself.

    Args:
        model: the object.
        frame: the image.
        start: B poses.
        count: model points used per pose.
        iterations: at most.
        prior: (6,) information of `start`: keeps weak directions where they were.
        params: tuning.
        coarse_only: leave the colours coarse and the reach wide.
        fine_only: take fine colours from the begin.
        right: expect each start to be right, which takes fewer steps where it is.
        points_W: (N, 3) image points to be explained.
    """
    R, p = np.array(start.R, dtype=float, order="C"), np.array(start.p, dtype=float, order="C")
    silhouette = Silhouette.of(model, frame, start)
    explain = np.empty((0, 3)) if points_W is None else one_layout(points_W)
    held = one_layout(np.asarray(prior, dtype=float))
    course = StepCourse(iterations, 0 if fine_only else TUNING.coarse_steps, coarse_only, right)
    rules = _rules(model, frame, params, course)
    used = min(count, model.views.shape[1])
    refine_poses(R, p, model.seen, model.cloud, _image_terms(frame, silhouette), explain, held, rules, used)
    return Poses(R, p)


def _image_terms(frame: Frame, silhouette: Silhouette | None) -> ImageTerms:
    """Return what an image gives to refine poses by."""
    shift = frame.shift
    return ImageTerms(
        images=frame.images,
        camera=frame.view,
        colours=frame.colours,
        corner=frame.corner_of_colours(),
        slopes=frame.colour_slopes,
        shift_information=np.zeros((2, 2)) if shift.certain else shift.information,
        shift_certain=shift.certain,
        outline=(silhouette or Silhouette.nowhere()).cells,
        any_outline=silhouette is not None,
    )


def _rules(model: ModelCloud, frame: Frame, params: scenario.Registration, course: StepCourse) -> Rules:
    """Return the constants of all terms and of the steps."""
    t = TUNING
    bounds = StepBound(*t.small_step), StepBound(*t.fine_from), StepBound(*t.right), StepBound(*t.largest_step)
    return Rules(
        looking=LOOKING.limits,
        noise=frame.noise,
        terms=term_rules(colour_weight(model, params)),
        outline=SILHOUETTE.cuts,
        pairs=pair_rules(model.spacing),
        sizes=StepSizes(params.reach, t.narrow, t.least_gain, *bounds),
        course=course,
    )


def colour_weight(model: ModelCloud, params: scenario.Registration) -> float:
    """Return what colours count beside depth: nothing, where the model has none."""
    return params.colour_weight if model.coloured else 0.0


def register(
    model: ModelCloud,
    frame: Frame,
    R: Array,
    p: Array,
    params: scenario.Registration,
    *,
    prior: Array | None = None,
    points_W: Array | None = None,
    rests: bool = False,
) -> RegisteredPose:
    """Register one object from a pose near the right one.

    Args:
        model: the object.
        frame: the image.
        R: (3, 3) predicted R_WO.
        p: (3,) predicted p_WO [m].
        params: tuning.
        prior: (6,) information of the prediction; None: 0.3 rad, 5 cm.
        points_W: (N, 3) image points that belong to the object, if known.
        rests: the prediction was right in the image before and is expected to be right again.
    """
    start = Poses(R[None], p[None])
    held = information(0.3, 0.05) if prior is None else prior
    for right in (True, False) if rests else (False,):
        poses = refine(
            model, frame, start, params.model_points, params.iterations, held, params, right=right, points_W=points_W
        )
        looked = look(model, frame, poses, params.model_points, FINE)
        fit = judge(looked, frame)
        if fit.shape[0] >= TUNING.in_place and fit.quality[0] >= TUNING.coloured * fit.shape[0]:
            break
    else:
        # Coarse colours of what hides a part reach over its rim, and may lead away from what was right to begin with.
        begun = judge(look(model, frame, start, params.model_points, FINE), frame)
        if begun.likeness[0] > TUNING.led_away * fit.likeness[0]:
            count, steps = params.model_points, params.iterations
            near = refine(model, frame, start, count, steps, held, params, fine_only=True, points_W=points_W)
            looked_near = look(model, frame, near, params.model_points, FINE)
            fit_near = judge(looked_near, frame)
            if fit_near.likeness[0] > fit.likeness[0]:
                poses, looked, fit = near, looked_near, fit_near
    # A data sheet that promises too much must not make claims too narrow.
    more = residual_excess(looked, frame)
    share = colour_weight(model, params)
    spread, evidence = claim(looked, frame, model, poses, points_W, TUNING.narrow, share, more)
    return RegisteredPose(
        R=poses.R[0],
        p=poses.p[0],
        covariance=spread,
        quality=float(min(fit.quality[0], 1.0)),
        likeness=float(fit.likeness[0]),
        visible_share=float(fit.visible_share[0]),
        points=float(fit.points[0]),
        shape=float(min(fit.shape[0], 1.0)),
        evidence=evidence,
    )


def claimed(
    model: ModelCloud, segments: Segments, R: Array, p: Array, reach: float, most: int | None = None
) -> npt.NDArray[np.int64]:
    """Return the indices of the segments' points within `reach` [m] of the surface, about `most` if that is given."""
    points, pose = segments.points, (one_layout(R), one_layout(p))
    return within(points, pose, model.nearest.grid, model.radius, reach, -1 if most is None else most)


def label_of(segments: Segments, own: npt.NDArray[np.int64]) -> int:
    """Return the number of the segment that most of an object's points `own`, at least one, are in."""
    return int(np.bincount(segments.labels[own]).argmax())
