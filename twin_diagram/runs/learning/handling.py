"""What is done with one object, from the bin that is emptied to the one that is filled; each part can be used alone."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.logs.frames.transforms_folder import write_transforms
from twin_diagram.model.model import Model
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.planning.grasps import Gripper
from twin_diagram.runs.learning.bearing import holding
from twin_diagram.runs.learning.beside_bin import (
    lying,
    over_platform,
    stand_about,
    stand_about_rest,
    support_of,
    upright_points,
    whole_of,
)
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.camera_check import KnownFaces
from twin_diagram.runs.learning.cell import RELEASE, Cell, Picture
from twin_diagram.runs.learning.choosing import Choice
from twin_diagram.runs.learning.coverage import hands_of, map_of, order_of, posed_frames, tilts_of, well_followed
from twin_diagram.runs.learning.display import display
from twin_diagram.runs.learning.felt_weight import Centre, Felt, bear, centre_felt, first_mass
from twin_diagram.runs.learning.following import Followed, cover, follow, follow_anew
from twin_diagram.runs.learning.held_turns import Weight, about_pads, middle, weight_felt
from twin_diagram.runs.learning.in_the_way import TUNING as IN_THE_WAY
from twin_diagram.runs.learning.in_the_way import why_barred, with_room
from twin_diagram.runs.learning.laying_down import lay_into, stand_or_lie
from twin_diagram.runs.learning.looking_about import LyingAbout, look_about
from twin_diagram.runs.learning.motion import Mover, NoWay, pointing, pose
from twin_diagram.runs.learning.picking import TUNING as PICKING
from twin_diagram.runs.learning.picking import Taken, go, lift_over, take
from twin_diagram.runs.learning.record import LearningError
from twin_diagram.runs.learning.regrasping import PLATFORM, fallen_pose, take_again
from twin_diagram.runs.learning.regrasping import TUNING as REGRASPING
from twin_diagram.runs.learning.setting_down import PutDown, outline, places_in, resting, set_down
from twin_diagram.runs.learning.shown_object import Picked, ShownObject
from twin_diagram.runs.learning.steadiness import FINE
from twin_diagram.runs.learning.steady_picture import refuse_blind, resting_picture
from twin_diagram.scenario import Camera, Learning
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    regrasped: tuple[float, float] = (0.004, 0.04)
    """How well the place of what was taken again is known [m], [rad]: what shutting fingers push it by."""

    same_place: float = 0.04
    """A thing within this of one that was given up is that one [m]."""

    floor: float = 0.003
    """Height over the bin's bottom that fingers stay above [m]."""

    dropped: tuple[float, ...] = (0.22, 0.4)
    """Heights of the tips over the bin's bottom where what cannot be set down falls [m]; the 2nd over tall things."""

    fallen: float = 0.05
    """Half of the size of something that was let fall [m], for who puts others beside it."""

    platform_spots: tuple[float, ...] = (0.0, 0.03, -0.03)
    """Off the platform's middle where things are set down [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Tools:
    """What handling needs: cell, planner, the arm's shapes, the gripper's figures, cameras, what stands still.

    `model`: of the arm as its torques are measured; `driven`: with its rotors, as its motors drive it.
    """

    cell: Cell
    mover: Mover
    robot: RobotShape
    gripper: Gripper
    learning: Learning
    home: Array
    model: Model
    driven: Model
    cameras: Mapping[str, Camera]
    faces: KnownFaces


def look_into_bin(tools: Tools, given_up: Sequence[Sequence[float]]) -> tuple[Picture, list[SeenThing]]:
    """Return a picture of the bin and what rests in it and beside it, without what was given up; the arm is at home.

    What lies on the platform comes first: others are to be set down there.

    Raises:
        LearningError: the arm cannot get out of the way.
        StationError: that camera, or the one to which things are to be shown, measures nothing.
    """
    try:
        go_home(tools)
    except NoWay as why:
        raise LearningError(f"the arm cannot go home to look: {why}; check twin.home and what stands about") from why
    low, high = (np.array(corner) for corner in tools.learning.from_bin)
    picture = resting_picture(tools.cell, tools.learning.bin_camera, low, high)
    things = lying(picture, tools.learning, tools.faces, tools.robot)
    gone = np.array([place[:3] for place in given_up]).reshape(-1, 3)
    left = [t for t in things if (np.linalg.norm(gone - t.middle, axis=1) > TUNING.same_place).all()]
    left.sort(key=lambda one: not over_platform(one, tools.learning))
    if left:  # nothing is taken that could not be shown
        refuse_blind(tools.learning.scan_camera, tools.cell.look(tools.learning.scan_camera).depth)
    return picture, left


def go_home(tools: Tools) -> None:
    """Go to where the arm hides nothing from the bin's camera."""
    if np.abs(tools.cell.commanded - tools.home).max() > 0.01:
        go(tools.cell, tools.mover.timed(tools.mover.path(tools.cell.commanded, tools.home[None])))


def choice_of(
    tools: Tools, thing: SeenThing, others: Sequence[SeenThing], attempt: int = 0, failed: Sequence[Array] = ()
) -> Choice:
    """Return what looks for a grasp of a thing that is reached; arguments as in `pick`."""
    corners = np.array(tools.learning.from_bin[0]), np.array(tools.learning.from_bin[1])
    rest = [whole_of(other) for other in others] + upright_points(tools.faces, thing)
    stand_about(tools.mover, tools.learning, [thing, *others])
    floor = support_of(thing, tools.learning) + TUNING.floor
    return Choice(tools.mover, tools.cell, tools.gripper, thing, corners, floor, rest, attempt, failed)


def pick(
    tools: Tools, thing: SeenThing, picture: Picture, attempt: int, failed: list[Array], known: Choice | None = None
) -> Picked:
    """Try to take a thing once: the best grasp that is reached, one unlike those that failed before others.

    Args:
        tools: of the cell.
        thing: that is to be taken.
        picture: in which it was seen; all else in it is in the way, also what was given up.
        attempt: number of the try, from 0.
        failed: (4, 4) poses of the tool at which it held nothing.
        known: what looked for that grasp before; None: it is looked for now.
    """
    around, high = lying(picture, tools.learning, tools.faces, tools.robot), tools.learning.from_bin[1][2]
    others = [other for other in around if (other.middle != thing.middle).any()]
    choice = known or choice_of(tools, thing, others, attempt, failed)
    if (reach := choice.best()) is None:
        return Picked(thing, why=why_barred(choice.why, thing, others))
    taken = take(tools.mover, tools.cell, reach)
    if taken is None:
        return Picked(thing, why="the fingers held nothing", failed=reach.X_WT)
    lift_over(tools.mover, tools.cell, taken, thing.points, high)
    stand_about(tools.mover, tools.learning, others)
    take_up(tools, thing, taken)
    return Picked(thing, taken, others=others)


def take_up(tools: Tools, thing: SeenThing, taken: Taken) -> None:
    """Tell planner and driver what was taken, as it lay: ways keep it clear of things, and it is borne."""
    points_T = (thing.points - taken.X_WT[:3, 3]) @ taken.X_WT[:3, :3]
    weight = _as_it_lay(tools, thing, taken)
    X_T = about_pads(weight.turned_by(tools.mover.tool(tools.cell.commanded)[:3, :3]))
    tools.mover.hold(np.vstack([points_T, points_T @ X_T[:3, :3].T + X_T[:3, 3]]))
    centre_T = X_T[:3, :3] @ weight.centre_T + X_T[:3, 3]
    tools.cell.borne.tell(holding(tools.driven, weight.mass, centre_T), tools.cell.time)


def _as_it_lay(tools: Tools, thing: SeenThing, taken: Taken) -> Weight:
    """Weigh what was taken at rest; return what is known of its weight, by where it lay."""
    support, mass = support_of(thing, tools.learning), first_mass(tools.model, tools.cell)
    return Weight.of_lying(mass, tools.cell.force, thing.points, support, taken.X_WT)


def show_first(tools: Tools, picked: Picked) -> ShownObject:
    """Show what was picked to the scanning camera, in its first grasp.

    Raises:
        NoWay, NothingHeld: see `display`.
    """
    assert picked.taken is not None
    # S is the tool's frame in the first picture, and it has not been turned since it was taken.
    weight = _as_it_lay(tools, picked.thing, picked.taken)
    (followed, felt), R_WS = _followed(tools, weight), picked.taken.X_WT[:3, :3]
    result = ShownObject(followed, [followed.X_ST[-1]], [tools.cell.apart], R_WT=R_WS @ followed.X_ST[-1][:3, :3])
    hold_seen(tools, result)
    stand_about_rest(tools.mover, tools.cell, tools.robot, tools.learning, picked.others)
    weight = replace(weight, centre_T=middle(result.in_tool()))
    if followed.slips and len((calm := _followed(tools, weight))[0].slips) < len(followed.slips):
        # By now it hangs as it will stay; pictures from while it slid fit each other less well.
        followed, felt = calm
        X_ST = followed.X_ST[-1]
        result = ShownObject(followed, [X_ST], [tools.cell.apart], R_WT=result.R_WT @ X_ST[:3, :3])
        hold_seen(tools, result)
    result.beside = [other.middle for other in picked.others if other.beside]
    feel(tools, result, felt)
    look_over(tools, result)
    return result


def _followed(tools: Tools, weight: Weight) -> tuple[Followed, Felt]:
    """Show what is held for the first time, follow it, and feel where its weight pulls."""
    felt = Felt()
    noted = partial(felt.note, tools.cell)
    pictures = display(tools.mover, tools.cell, tools.learning, tools.robot, 0, during=noted, weight=weight)
    return follow(Followed(), pictures, np.eye(4)), felt


def feel(tools: Tools, shown: ShownObject, felt: Felt) -> None:
    """Note how heavy the object seems at rest, and where its weight pulled as it was turned."""
    if tools.cell.opening < PICKING.empty:
        return
    shown.mass_at_rest = first_mass(tools.model, tools.cell)
    before = shown.centre or Centre.within(shown.followed.points)
    X_TS = np.asarray(np.linalg.inv(shown.X_ST[-1]), dtype=float)
    shown.centre = centre_felt(tools.model, felt, shown.mass_at_rest, X_TS, before)
    centre_T = X_TS[:3, :3] @ shown.centre.mean + X_TS[:3, 3]
    tools.cell.borne.tell(holding(tools.driven, shown.mass_at_rest, centre_T), tools.cell.time)


def look_over(tools: Tools, shown: ShownObject) -> None:
    """Note how well the object's surface was seen by now."""
    shown.seen = map_of(shown.followed, shown.X_ST, shown.openings, tools.gripper)
    shown.seen_shares.append(shown.seen.seen_share)


def hold_seen(tools: Tools, shown: ShownObject) -> None:
    """Tell the planner what is held, as far as it was seen."""
    tools.mover.hold(shown.in_tool())


def show_again(tools: Tools, shown: ShownObject, firm: bool = False) -> bool:
    """Set the object down on the platform, take it in another grasp and show it again; whether that succeeded.

    Where the first turn of the fingers cannot be had, what is known stays, and the hand may be empty: `holding` tells.
    With `firm` the grasp is to hold the object's weight, whatever it shows.

    Raises:
        NoWay: it cannot be set down.
        NothingHeld: it was lost on the way, or no picture shows enough of it to be followed.
    """
    low, high = (np.array(corner) for corner in tools.learning.platform)
    middle = 0.5 * (low + high)[:2]
    spots = [np.array([*(middle + [dx, dy]), high[2]]) for dx in TUNING.platform_spots for dy in TUNING.platform_spots]
    X_WS = stand_or_lie(tools.mover, tools.cell, shown, spots)
    R_WS_lying = X_WS[:3, :3]
    tools.mover.stand(PLATFORM, [cover(shown.followed) @ X_WS[:3, :3].T + X_WS[:3, 3]], float(high[2]))
    go_home(tools)  # out of the camera's sight of the platform
    assert shown.seen is not None
    p_WC = shown.followed.shown[-1].picture.camera.p_WC
    order = partial(
        order_of, held=shown.X_ST, seen=shown.seen, gripper=tools.gripper, learning=tools.learning, p_WC=p_WC, firm=firm
    )
    look = partial(_look_again, tools, shown.beside)
    walls = partial(walls_about, tools)
    found = take_again(tools.mover, tools.cell, tools.learning, tools.gripper, shown, X_WS, order, look, walls)
    tools.mover.stand(PLATFORM, [], 0.0)
    if found is None:
        return False
    _show_held(tools, shown, found[1], R_WS_lying)
    return True


def _show_held(tools: Tools, shown: ShownObject, X_ST: Array, R_WS: Array) -> None:
    """Show what was taken again.

    Args:
        tools: of the cell.
        shown: the object, as it was seen before.
        X_ST: (4, 4) of the tool in S.
        R_WS: (3, 3) axes of S in W as it lay when it was taken.

    Raises:
        NoWay, NothingHeld: see `display` and `follow_anew`.
    """
    shown.X_ST.append(X_ST)
    shown.openings.append(tools.cell.apart)
    shown.R_WT = R_WS @ X_ST[:3, :3]
    hold_seen(tools, shown)
    bear(tools.model, tools.driven, tools.cell, shown.in_tool())
    assert shown.seen is not None
    p_WC = shown.followed.shown[-1].picture.camera.p_WC
    felt, hand = Felt(), Boxes(X_ST, *tools.gripper.boxes(tools.cell.apart))
    number, tilts = len(shown.X_ST) - 1, tilts_of(shown.seen, hand, tools.learning, p_WC)
    noted = partial(felt.note, tools.cell)
    weight = weight_felt(shown.mass_at_rest, shown.centre, shown.X_ST[-1], tools.cell.force)
    pictures = display(tools.mover, tools.cell, tools.learning, tools.robot, number, tilts, noted, weight)
    shown.followed = follow_anew(shown.followed, pictures, X_ST, TUNING.regrasped)
    shown.X_ST[-1] = shown.followed.X_ST[-1]
    shown.R_WT = R_WS @ shown.X_ST[-1][:3, :3]
    hold_seen(tools, shown)
    feel(tools, shown, felt)
    look_over(tools, shown)


def show_found(tools: Tools, shown: ShownObject, found: LyingAbout, taken: Taken) -> bool:
    """Show what was lost after it had been shown, and was found and taken; whether it is known how it is held.

    Where that is not, no picture of it explains itself by what was seen before, and what is known of it stays.

    Raises:
        NoWay, NothingHeld: see `display` and `follow_anew`.
    """
    points, normals = found.thing.points[:1500], found.thing.normals[:1500]
    guess = taken.X_WT @ np.linalg.inv(shown.X_ST[-1])
    X_SW, share = fallen_pose(shown.followed, points, normals, guess, found.support)
    if share <= REGRASPING.same:
        return False
    before = replace(shown, X_ST=[*shown.X_ST], openings=[*shown.openings], seen_shares=[*shown.seen_shares])
    _show_held(tools, shown, X_SW @ taken.X_WT, X_SW[:3, :3].T)
    if max(well_followed(shown.followed), default=0) >= len(before.followed.shown):
        return True
    shown.followed, shown.X_ST, shown.openings, shown.R_WT = before.followed, before.X_ST, before.openings, before.R_WT
    shown.seen, shown.seen_shares, shown.centre = before.seen, before.seen_shares, before.centre
    return False


def _look_again(tools: Tools, known: Sequence[Array]) -> LyingAbout | None:
    """Return what was set down, wherever it lies now; the arm, after a try over it, goes out of the cameras' sight."""
    with contextlib.suppress(NoWay):
        go_home(tools)
    return look_about(tools.cell, tools.learning, tools.faces, tools.robot, known)


def walls_about(tools: Tools, thing: SeenThing) -> list[Array]:
    """Return points (N, 3) of walls about a thing on the table, in the hand's way: with room, then without [m]."""
    walls = np.vstack([np.zeros((0, 3)), *upright_points(tools.faces, thing)])
    return [with_room(walls, room) for room in IN_THE_WAY.rooms] if len(walls) else [walls]


def keep_clear(tools: Tools, standing: Sequence[PutDown]) -> None:
    """Keep all ways from here on, and all swinging, clear of what stands in the other bin."""
    floor = float(tools.learning.into_bin[0][2])
    tools.mover.stand("other bin", [outline(one) for one in standing], floor)


def put_away(tools: Tools, shown: ShownObject, standing: Sequence[PutDown]) -> PutDown:
    """Put what is held into the other bin, beside what stands there and `keep_clear` was told of; return where.

    Raises:
        NoWay: no place is reached.
    """
    low, high = (np.array(corner) for corner in tools.learning.into_bin)
    points_T, why = shown.in_tool(), NoWay("no room in the other bin")
    if (laid := lay_into(tools.mover, tools.cell, shown, low, high, standing)) is not None:
        keep_clear(tools, [*standing, laid])
        return laid
    for R_WT in resting(shown.in_tool(FINE), shown.R_WT):
        places = places_in(low, high, standing, points_T, R_WT)
        if not places:
            continue
        try:
            _, place = set_down(tools.mover, tools.cell, points_T, R_WT, places)
        except NoWay as error:
            why = error
            continue
        put = PutDown.standing(points_T, R_WT, place)
        keep_clear(tools, [*standing, put])
        return put
    raise why


def let_go(tools: Tools) -> PutDown | None:
    """Empty the hand over the bin that is filled, or where it is if there is no way there, and go home.

    Returns:
        About where it lies in that bin; None: nothing was let fall there.

    Raises:
        NoWay: there is no way home; the hand is empty.
    """
    low, high = (np.array(corner) for corner in tools.learning.into_bin)
    (x, y), fell = 0.5 * (low + high)[:2], None
    down = pointing(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]))
    for height in TUNING.dropped if tools.cell.shut and tools.cell.opening > PICKING.empty else ():
        with contextlib.suppress(NoWay):
            goals = tools.mover.goals(pose(down, np.array([x, y, low[2] + height])), tools.cell.commanded)
            go(tools.cell, tools.mover.timed(tools.mover.path(tools.cell.commanded, goals)))
            fell = PutDown((float(x), float(y)), TUNING.fallen, float(low[2]) + 2 * TUNING.fallen)
            break
    with tools.cell.about(RELEASE, tools.mover.tool(tools.cell.q)[:3, 3]):
        tools.cell.grip(1.0)
    tools.mover.hold(None)
    go_home(tools)
    return fell


def write_frames(folder: Path, shown: ShownObject, gripper: Gripper) -> None:
    """Write the pictures with poses in S, masks, and where the hand was, as reconstruction backends read them."""
    write_transforms(folder, *posed_frames(shown.followed), hands_of(shown.followed, shown.openings, gripper))
