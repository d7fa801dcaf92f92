"""Writes a first scenario for an arm that somebody brings along: commented, complete, and it runs as it is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, PrismaticJoint, RevoluteJoint, WeldJoint

from twin_diagram import scenario
from twin_diagram.errors import TwinError
from twin_diagram.model.description import held_joints, unparsed
from twin_diagram.model.description.add_arm import Arm, add_arm
from twin_diagram.model.model import Model
from twin_diagram.planning.collision.between_fingers import between_fingers, grips, told_in
from twin_diagram.planning.collision.chain import Chain
from twin_diagram.planning.collision.collision_scene import Forecast, load_scene
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.output_place import why_not
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Where a first arm stands: chosen by hand."""

    margin: float = 0.1
    """Share of a joint's range that its angle at home keeps from both ends."""

    tries: int = 400
    """Poses that are tried for one that is clear of the table and of the arm itself."""

    clear: float = 0.1
    """A home this clear is as good as any further away [m]."""

    table: str = "scenes/table.sdf"
    """Comes along; the arm stands on it, at the origin."""

    camera: str = "{translation: [1.4, 0.0, 0.85], rpy: [-2.270689, 0.0, 1.570796]}"
    """Looks at the table from its far side; `tests/runs/test_first_scenario.py` shows that it sees it."""


TUNING = Tuning()

_TOOLS = ("tcp", "tool", "ee|eef|end_?effector")
"""Words in the names that descriptions give the frame that works; the likelier first."""


@dataclass(frozen=True)
class Brought:
    """What is known of an arm that somebody brings along.

    Attributes:
        joints: names, from the base.
        lower, upper: (n,) limits [rad], [m]; infinite where the description names none.
        frames: of its last link and beyond, candidates for the tool; first one that is called so, else the link's own.
        home: (n,) within the limits; clear of the table where `stands`.
        stands: whether a pose was found that is clear of the table.
        loose: names of further joints, which have no motor by the description and follow no other joint.
        held: names of joints of a hand that tendons pull.
        grip: of a hand, what the scenario says where the frame between its finger tips lies in the first of `frames`;
            empty: it is that frame, or there are no fingers.
        drawn_only: links with a visual and no collision shape: a camera takes them for unknown things.
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    frames: tuple[str, ...]
    home: Array
    stands: bool
    loose: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    drawn_only: tuple[str, ...] = ()
    grip: str = ""

    def notes(self, arm: object) -> list[str]:
        """Return what whoever brought `arm` should know, in a line each."""
        said = []
        if self.loose:
            loose = f"{', '.join(self.loose)}: without a motor in {arm}, so they hang loose"
            said.append(f"{loose}; twin.arm.joints names all that are driven")
        if self.held:
            held = f"{', '.join(self.held)}: held, as nothing is read of the tendons in {arm}"
            said.append(f"{held}; twin.arm.joints names all that are driven")
        if self.drawn_only:
            drawn = f"{', '.join(self.drawn_only)}: drawn, but without a collision shape"
            said.append(f"{drawn}: a camera sees an unknown thing there, and no plan keeps it clear")
        return said


def write_first_scenario(
    arm: str | Path,
    out: str | Path,
    packages: Mapping[str, str | Path] | None = None,
    joints: Sequence[str] = (),
) -> Brought:
    """Write a scenario for an arm; nothing that exists is overwritten.

    Args:
        arm: URDF, SDF or MJCF, or the folder of a corrected model.
        out: the .yaml to write.
        packages: local folders for `package://` names.
        joints: of one arm, in order, of a robot that has more; the others are held. Empty: all.

    Raises:
        TwinError: the arm cannot be used, or `out` exists or cannot be written.
    """
    out = Path(out)
    if out.suffix not in (".yaml", ".yml"):
        raise TwinError(f"--out {out}: a scenario is a .yaml file")
    if out.exists():
        raise TwinError(f"--out {out}: exists already; name another file, or remove it yourself")
    if not out.parent.is_dir():
        raise TwinError(f"--out {out}: there is no folder {out.parent}")
    if why := why_not(out, folder=False):
        raise TwinError(f"--out {out}: {why}")
    found = look_at(arm, packages, joints)
    atomic_file.write(out, text_of(str(_place(arm)), found, packages or {}, joints))
    return found


def look_at(arm: str | Path, packages: Mapping[str, str | Path] | None = None, joints: Sequence[str] = ()) -> Brought:
    """Read an arm's joints, limits and frames, and find it a home; see `write_first_scenario`.

    Raises:
        ModelError: it cannot be read, or has no joint to drive.
    """
    spec = scenario.ArmModel(model=str(arm), tool_frame="", joints=list(joints))
    model = Model.load(spec, packages)  # refuses what a run would refuse,
    Chain.from_plant(model.plant, model.arm.joint_indices, model.arm.tool_frame)  # and before meshes are read
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    added = add_arm(plant, spec, packages)
    last = plant.get_body(added.last_link)
    # Drake names the frames of joints after them; nobody reaches a goal with these.
    inner = {f"{joint.name()}_{end}" for joint in _joints(plant, added) for end in ("parent", "child")}
    welded = {int(body.index()) for body in plant.GetBodiesWeldedTo(last)}
    every = [plant.get_frame(index) for instance in added.instances for index in plant.GetFrameIndices(instance)]
    beyond = [frame.name() for frame in every if int(frame.body().index()) in welded and frame.name() not in inner]
    frames = _tool_first(tuple(dict.fromkeys([last.name(), *(name for name in beyond if name)])))
    movable = [j.name() for j in _joints(plant, added) if isinstance(j, (RevoluteJoint, PrismaticJoint))]
    welds = () if joints else (joint.name() for joint in _joints(plant, added) if isinstance(joint, WeldJoint))
    plant.Finalize()
    frames, grip = _gripping(plant, scene_graph, added, frames)
    own = [plant.get_joint(index) for index in added.joint_indices]
    lower = np.array([float(joint.position_lower_limits()[0]) for joint in own])
    upper = np.array([float(joint.position_upper_limits()[0]) for joint in own])
    home, stands = _home(spec, lower, upper, packages)
    known = {*added.joints, *added.gripper_joints, *unparsed.of_all(unparsed.following, added.parts)}
    loose = tuple(name for name in movable if name not in known)
    held = tuple(name.removesuffix(held_joints.HELD) for name in welds if name.endswith(held_joints.HELD))
    links = [plant.get_body(index) for instance in added.instances for index in plant.GetBodyIndices(instance)]
    drawn = [link for link in links if plant.GetVisualGeometriesForBody(link)]
    drawn_only = tuple(link.name() for link in drawn if not plant.GetCollisionGeometriesForBody(link))
    return Brought(added.joints, lower, upper, frames, home, stands, loose, held, drawn_only, grip)


def _tool_first(frames: tuple[str, ...]) -> tuple[str, ...]:
    """Return frames with the one in front that its name says to be the tool's."""
    for word in _TOOLS:
        named = [name for name in frames if re.search(rf"(?:^|[_/-])(?:{word})\d*(?:$|[_/-])", name.lower())]
        if named:
            return (named[0], *(name for name in frames if name != named[0]))
    return frames


def _gripping(
    plant: MultibodyPlant, scene_graph: SceneGraph, arm: Arm, frames: tuple[str, ...]
) -> tuple[tuple[str, ...], str]:
    """Return frames with one in front that grips where there is a hand, and else what to say of the first."""
    X_LG = between_fingers(plant, scene_graph, arm)
    if X_LG is None:
        return frames, ""
    last, context = plant.get_body(arm.last_link).body_frame(), plant.CreateDefaultContext()
    places = {
        name: np.asarray(plant.CalcRelativeTransform(context, plant.get_frame(index), last).GetAsMatrix4()) @ X_LG
        for instance in reversed(arm.instances)
        for index in plant.GetFrameIndices(instance)
        if (name := plant.get_frame(index).name()) in frames
    }
    for name in frames:
        if grips(places[name]):
            return (name, *(other for other in frames if other != name)), ""
    hand = plant.get_joint(arm.gripper_joint_indices[0]).parent_body().name()
    first = hand if hand in frames else frames[0]
    return (first, *(other for other in frames if other != first)), told_in(places[first])


def _joints(plant: MultibodyPlant, arm: Arm) -> list[Joint]:
    """Return all joints of an arm, those that are fixed, too."""
    return [plant.get_joint(index) for instance in arm.instances for index in plant.GetJointIndices(instance)]


def _home(
    spec: scenario.ArmModel, lower: Array, upper: Array, packages: Mapping[str, str | Path] | None
) -> tuple[Array, bool]:
    """Return angles (n,) within the limits, and whether the arm is clear of a table and of itself there."""
    low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - np.pi, -np.pi / 2))
    high = np.where(np.isfinite(upper), upper, np.where(np.isfinite(lower), lower + np.pi, np.pi / 2))
    low, high = low + TUNING.margin * (high - low), high - TUNING.margin * (high - low)
    rest = np.clip(np.zeros(len(low)), low, high)
    spread = np.random.default_rng(0).uniform(low, high, (TUNING.tries, len(low)))
    # Least out of the way first: an arm that already stands clear at rest stays as its maker drew it.
    tried = np.vstack([rest, 0.5 * (low + high), *(rest + share * (spread - rest) for share in (0.3, 0.6, 1.0))])
    scene = load_scene(spec, [scenario.Fixture(model=TUNING.table)], {}, packages)
    around = scene.around(Forecast.of_tracks(np.zeros(0)), np.zeros(len(tried)))
    distances = scene.clearance.distances(tried, around, 2.0 * TUNING.clear)
    table, own = distances[:, :-1].min(axis=1), distances[:, -1]
    # A hand may lie close to the wrist wherever they turn: no pose is clearer of the arm itself, and none touches.
    freest = (own > 0.0) & (own >= 0.5 * own.max())
    for clear in (np.minimum(table, own), np.where(freest, table, -np.inf)):
        best = int(np.argmax(np.minimum(clear, TUNING.clear)))
        if clear[best] > 0.2 * TUNING.clear:
            return tried[best], True
    return rest, False


def _place(arm: str | Path) -> str | Path:
    """Return a file's absolute path; names of models that come along, and packages, stay as they are."""
    path = Path(arm).expanduser()
    return path.resolve() if path.exists() else arm


def text_of(arm: str, found: Brought, packages: Mapping[str, str | Path], joints: Sequence[str] = ()) -> str:
    """Return a scenario's YAML, with comments that say what may be changed.

    Args:
        arm: its description, as the scenario names it.
        found: what is known of it.
        packages: local folders for `package://` names.
        joints: those that were named.
    """
    fixtures = ["  fixtures:", f"    - model: {TUNING.table}"]
    if not found.stands:
        fixtures = [
            "  # No pose was found that is clear of a table at its feet and of the arm itself: set home and table.",
            "  fixtures: []",
        ]
    named = ["packages:", *(f"  {name}: {_quoted(str(Path(folder).resolve()))}" for name, folder in packages.items())]
    arm_lines = [f"    model: {_quoted(arm)}", f"    tool_frame: {_quoted(found.frames[0])}"]
    arm_lines += [f"    {found.grip}"] if found.grip else []
    named_joints = [f"    joints: [{', '.join(map(_quoted, joints))}]"] if joints else []
    lines = [
        f"# A first scenario for {Path(arm).name}: `twin-diagram run` runs it as it is, `twin-diagram fields` tells of",
        "# every field. All units SI, angles in radians.",
        "duration: 5.0  # [s]",
        *(named if packages else ["# packages: {my_arm_description: DIR}  # where package://my_arm_description is"]),
        "",
        "# What a simulated station needs, and the twin never sees. Give it something to find:",
        "# effects: [{name: payload, parameters: {mass: [0.5], com: [0.0, 0.0, 0.1]}}]",
        "world:",
        "  arm:",
        *arm_lines,
        *named_joints,
        *fixtures,
        "",
        "# What the twin is told.",
        "twin:",
        "  arm:",
        *arm_lines[:1],
        f"    # The frame that reaches goals; others at the last link: {', '.join(found.frames[1:]) or 'none'}.",
        *arm_lines[1:2],
        *(
            ["    # By the shapes of its fingers: between their tips, z along the approach, y along the closing."]
            if found.grip
            else []
        ),
        *arm_lines[2:],
        *named_joints,
        *_limits(found),
        f"  home: [{', '.join(f'{angle:.4f}' for angle in found.home)}]",
        *fixtures,
        "  # Known objects by name, folders of assets: {mug: objects/mug}",
        "  library: {}",
        "  # Optical frame: X right, Y down, Z forward. Without a camera (camera: null) the run needs no renderer.",
        "  camera:",
        f"    X_WC: {TUNING.camera}",
        "  # Where the tool is to go; without a goal the arm stays.",
        "  # task: {X_WG: {translation: [0.5, 0.0, 0.3], rpy: [3.141593, 0.0, 0.0]}}",
    ]
    return "\n".join(lines) + "\n"


def _limits(found: Brought) -> list[str]:
    """Return comments that say how far joints go."""
    unlimited = [joint for joint, low, high in zip(found.joints, found.lower, found.upper, strict=True) if low >= high]
    boundless = ~(np.isfinite(found.lower) & np.isfinite(found.upper))
    ranges = [
        f"  #   {joint}: {low:.4g} to {high:.4g}" + ("  (no limit named)" if free else "")
        for joint, low, high, free in zip(found.joints, found.lower, found.upper, boundless, strict=True)
    ]
    no_room = [f"  # Limits that leave no room: {', '.join(unlimited)}"] if unlimited else []
    return ["  # Joints from the base, with their limits:", *ranges, *no_room]


def _quoted(text: str) -> str:
    """Return text as YAML reads it back."""
    return "'" + text.replace("'", "''") + "'"
