"""Begins or resumes a run of learning, and refuses at the start what cannot be: each refusal is one line."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from twin_diagram.errors import ModelError, ScenarioError, TwinError
from twin_diagram.model.description import add_arm
from twin_diagram.model.model import Model
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.planning.collision.geometry_to_solids import fixture_solids
from twin_diagram.planning.grasps import gripper_of
from twin_diagram.runs.learning.camera_check import KnownFaces
from twin_diagram.runs.learning.cell import Cell, Observer, told_camera
from twin_diagram.runs.learning.contact_count import ContactCount, Watchers
from twin_diagram.runs.learning.display import TUNING as DISPLAY
from twin_diagram.runs.learning.display import tool_at
from twin_diagram.runs.learning.finishing import finish, in_words
from twin_diagram.runs.learning.gallery import write_gallery
from twin_diagram.runs.learning.handling import Tools
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.runs.learning.pipeline import Learner
from twin_diagram.runs.learning.record import LearningError, LearningRecord, RunState
from twin_diagram.runs.learning.shape_worker import FRAMES, make_shape
from twin_diagram.runtime import stopping
from twin_diagram.runtime.threads import one_thread
from twin_diagram.scenario import Learning, Scenario
from twin_diagram.scenario.validation import check_twin

Say = Callable[[str], None]


def check_cell(scenario: Scenario) -> Learning:
    """Return what a scenario says of learning, checked against its cameras.

    Raises:
        ScenarioError: its station is not the simulated one, it says nothing or what cannot be, its arm cannot be read
            or has no gripper, or a camera sees neither bin nor platform; it names the field.
    """
    twin = scenario.twin
    if scenario.station != "sim":
        raise ScenarioError(
            "station", f"{scenario.station!r}: objects are learned in the simulated station alone; set sim"
        )
    check_twin(twin)
    learning = twin.learning
    if learning is None:
        raise ScenarioError("twin.learning", "is missing: it tells the bins, the platform and the cameras")
    try:
        fingers = Model.load(twin.arm, dict(scenario.packages)).arm.gripper_joint_indices
    except ModelError as error:
        raise add_arm.scenario_error("twin.arm", error) from error
    if not fingers:
        raise ScenarioError("twin.arm.model", f"{twin.arm.model} has no gripper to take objects with")
    platform = [[*learning.platform[0][:2], learning.platform[1][2]], learning.platform[1]]
    for field, box in (("bin_camera", learning.from_bin), ("scan_camera", platform)):
        name = getattr(learning, field)
        camera = told_camera(twin.cameras[name])
        middle = np.mean(np.array(box), axis=0)
        u, v, z = camera.project(middle)
        near, far = twin.cameras[name].depth_range
        if not (0 <= u < camera.width and 0 <= v < camera.height and near < z < far):
            what = "the bin" if field == "bin_camera" else "the platform"
            raise ScenarioError(
                f"twin.cameras.{name}.X_WC", f"the camera does not see {what} at {middle.round(3).tolist()}"
            )
    return learning


def tools_of(scenario: Scenario, learning: Learning) -> Tools:
    """Build the cell of a scenario and what handles it."""
    twin, packages = scenario.twin, dict(scenario.packages)
    gripper = gripper_of(learning.gripper)
    cell = Cell(scenario)
    model = Model.load(twin.arm, packages, torque_side=twin.driver.torque_side)
    mover = Mover(twin, packages, np.asarray(model.velocity_limit), scenario.seed)
    driven = model if twin.driver.torque_side == "motor" else Model.load(twin.arm, packages, torque_side="motor")
    home = np.array(twin.home, dtype=float) if twin.home else np.zeros(len(model.joints))
    faces = KnownFaces.of([solid for _, solids in fixture_solids(twin.fixtures, packages) for solid in solids])
    robot = RobotShape(twin.arm, packages)
    return Tools(cell, mover, robot, gripper, learning, home, model, driven, twin.cameras, faces)


def check_display(tools: Tools) -> None:
    """Refuse a place to show objects at that the empty arm does not reach: each would be let fall unlearned.

    Raises:
        ScenarioError: it does not, however the tool is tilted.
    """
    tilts = (*DISPLAY.tilts, *DISPLAY.more_tilts)
    if not any(len(tools.mover.goals(tool_at(tools.learning, tilt), tools.home)) for tilt in tilts):
        raise ScenarioError(
            "twin.learning.display",
            f"{list(tools.learning.display)}: the fingers do not get there, or touch something; give another place",
        )


@one_thread()
def learn(
    scenario: Scenario, out: str | Path, *, resume: bool = False, say: Say = print, observer: Observer | None = None
) -> RunState:
    """Empty a bin and learn what lies in it.

    Args:
        scenario: with ``twin.learning``.
        out: folder of the run: assets in `library/`, `events.jsonl`, `gallery.html`.
        resume: go on with the run in that folder.
        say: is told of each stage.
        observer: of the true world, for scorers: nothing that is learned gets anything of it back.

    Returns:
        What is known of each object.

    Raises:
        ScenarioError, ModelError: a cell that cannot be.
        LearningError: a folder that cannot be written, at the start or later, is another run's, or has another process
            at work in it.
        Stopped: a signal came; the state is that before the object in hand.
    """
    learning = check_cell(scenario)
    record = LearningRecord(Path(out), scenario)
    if not resume:
        record.check_place()
    with ExitStack() as held:
        if resume:
            held.enter_context(record.alone(new=False))
        state = record.resume() if resume else None
        tools = tools_of(scenario, learning)  # what cannot be built leaves no folder behind
        check_display(tools)
        if state is None:
            held.enter_context(record.alone(new=True))
            state = record.begin()
        contacts = ContactCount(partial(record.event, stage="contact"))
        tools.cell.observer = Watchers(contacts, observer)
        try:
            with stopping.steps():
                Learner(tools, record, state, say).run()
        except OSError as error:  # of a disk that is full the system names no file
            why = f"{error.filename or f'--out {out}'}: {error.strerror or error}"
            raise LearningError(f"{why}; once that is mended, --resume goes on with the run") from error
        say(f"contacts that no step asked for: {record.unasked()}")
    return state


@one_thread()
def learn_again(scenario: Scenario, out: str | Path, name: str, say: Say = print) -> RunState:
    """Make an object's asset once more from the data that a run kept of it; what it had stays where that fails.

    Raises:
        LearningError: no run, another scenario, another process at work in it, no such object in it, or its asset,
            which it had, cannot be made.
        FramesError: its frames cannot be used.
    """
    record = LearningRecord(Path(out), scenario)
    with record.alone(new=False):
        return _learn_again(scenario, record, name, say)


def _learn_again(scenario: Scenario, record: LearningRecord, name: str, say: Say) -> RunState:
    state = record.resume()
    one = state.named(name)
    folder = record.of(name)
    if not (folder / FRAMES).is_dir():
        raise LearningError(f"--again {name}: no pictures of it were kept")
    say(f"{name}: reconstruct")
    had = one.state == "finished"
    try:
        make_shape(folder)
    except TwinError:
        raise
    except Exception as error:  # of pictures, solvers, memory
        raise LearningError(f"--again {name}: its shape cannot be made: {in_words(error)}") from error
    side = scenario.twin.driver.torque_side
    finish(record, one, Model.load(scenario.twin.arm, dict(scenario.packages), torque_side=side))
    if had and one.state != "finished":
        raise LearningError(f"--again {name}: {one.no_asset}; the asset that it had stays")
    record.event(object=name, stage="again", outcome=one.state, **({"why": one.told} if one.told else {}))
    record.save(state)
    write_gallery(record, state)
    say(f"{name}: {one.state}")
    return state
