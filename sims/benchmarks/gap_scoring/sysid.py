"""MuJoCo's own toolbox for system identification: fits all parameters that its model has."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from gap_truth.cases import model_path
from gap_truth.chain import mjcf

from gap_scoring.regressions import CUT, Answer, Data, read

Array = npt.NDArray[np.float64]

WINDOW, WINDOWS = 0.25, 40

INSIDE = 0.02
"""Share of a parameter's range by which it starts away from its bounds."""


def mujoco_sysid(folder: Path) -> Answer:
    """Damping, rotor and dry friction of every joint and mass of every link, by rollouts of a quarter second."""
    sysid = importlib.import_module("mujoco.sysid")
    fit, held = read(folder, "fit.csv"), read(folder, "holdout.csv")
    chain, joints = fit.setting.chain, fit.setting.chain.joints
    motors = "".join(f'<motor name="{j}" joint="{j}"/>' for j in joints)
    sensors = "".join(f'<jointpos name="{j}" joint="{j}"/>' for j in joints)
    tail = f"<actuator>{motors}</actuator><sensor>{sensors}</sensor>"
    spec = mujoco.MjSpec.from_string(mjcf(chain, timestep=1e-3, tail=tail))
    for joint, effect in _baseline(folder):
        for key, value in effect.items():
            _put(spec.joint(joint), key, value)
    model = spec.compile()
    first = round(CUT * fit.rate)
    starts = np.linspace(first, len(fit.setting.time) - first - round(WINDOW * fit.rate), WINDOWS).astype(int)
    sequences: list[list[Any]] = [[], [], [], []]
    for k, start in enumerate(starts):
        span = np.arange(0.0, WINDOW, 1e-3)
        index = fit.setting.time[start] + span
        torque, angle = (
            np.stack([np.interp(index, fit.setting.time, x) for x in signal.T], axis=1)
            for signal in (fit.setting.torque, fit.setting.q)
        )
        state = sysid.create_initial_state(model, fit.setting.q[start], fit.setting.v[start], np.zeros(0))
        for target, value in zip(
            sequences,
            (
                f"w{k}",
                state,
                sysid.TimeSeries(span, torque),
                sysid.TimeSeries.from_names(span[1:], angle[1:], model),
            ),
            strict=True,
        ):
            target.append(value)
    parameters = sysid.ParameterDict()
    nominal: dict[str, float] = {}
    for k, joint in enumerate(joints):
        for key, top in (("damping", 0.5), ("armature", 0.1), ("frictionloss", 0.2)):
            now = float(np.ravel(getattr(spec.joint(joint), key))[0])
            _add(
                sysid,
                parameters,
                nominal,
                f"{key}:{joint}",
                now,
                0.0,
                now + top * chain.links[k].effort,
                _joint(joint, key),
            )
        mass = chain.links[k].mass
        _add(sysid, parameters, nominal, f"mass:link_{k + 1}", mass, 0.3 * mass, mass + 5.0, _body(f"link_{k + 1}"))
    names, states, controls, measured = sequences
    group = sysid.ModelSequences("arm", spec, names, states, controls, measured)
    residual = sysid.build_residual_fn(models_sequences=[group], n_threads=1)
    with contextlib.redirect_stdout(io.StringIO()):
        found, result = sysid.optimize(parameters, residual, optimizer="mujoco", verbose=False, max_iters=15)
    x = found.as_vector()
    J = np.asarray(result.jac)
    errors = np.concatenate([np.ravel(r) for r in residual(x, found)[0]])
    covariance = np.linalg.pinv(J.T @ J) * float(errors @ errors) / max(1, len(errors) - len(x))
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    effects: dict[str, dict[str, Any]] = {}
    catalogue = {"damping": "viscous_friction", "armature": "reflected_inertia", "frictionloss": "coulomb_friction"}
    for (label, before), now, error in zip(nominal.items(), x, std, strict=True):
        if abs(now - before) <= 3.0 * error or abs(now - before) < 1e-9:
            continue
        key, place = label.split(":")
        last = place == chain.link_names[-1]
        name = catalogue.get(key, "payload" if last else "inertial_parameters")
        entry = effects.setdefault(name, {"name": name, "joints": [], "links": [], "confidence": 1.0})
        entry["links" if key == "mass" else "joints"].append(place)
    return Answer(list(effects.values()), _sysid_residual(held, spec, found, sysid))


def _add(
    sysid: Any, parameters: Any, nominal: dict[str, float], name: str, now: float, low: float, high: float, change: Any
) -> None:
    # From a bound its optimizer does not get away (it warns of that itself).
    start = min(max(now, low + INSIDE * (high - low)), high)
    parameters.add(sysid.Parameter(name, start, low, high, modifier=change))
    nominal[name] = now


def _joint(joint: str, key: str) -> Callable[[Any, Any], None]:
    def change(spec: Any, parameter: Any) -> None:
        _put(spec.joint(joint), key, float(parameter.value[0]))

    return change


def _put(joint: Any, key: str, value: float) -> None:
    """Sets a joint's value; later versions of MuJoCo have a polynomial of the speed for damping, linear one first."""
    present = np.asarray(getattr(joint, key))
    setattr(joint, key, np.concatenate([[value], np.zeros(present.size - 1)]) if present.ndim else value)


def _body(link: str) -> Callable[[Any, Any], None]:
    def change(spec: Any, parameter: Any) -> None:
        spec.body(link).mass = float(parameter.value[0])

    return change


def _baseline(folder: Path) -> list[tuple[str, dict[str, float]]]:
    path = model_path(folder)
    if not path.is_dir():
        return []
    keys = {"coulomb_friction": "frictionloss", "viscous_friction": "damping"}
    return [
        (joint, {keys[effect["name"]]: value})
        for effect in json.loads((path / "effects.yaml").read_text(encoding="utf-8"))["effects"]
        for joint, value in zip(effect["joints"], next(iter(effect["parameters"].values())), strict=True)
    ]


def _sysid_residual(held: Data, spec: Any, found: Any, sysid: Any) -> Array:
    """Measured torque less that of the fitted model on the held-out motion."""
    model = sysid.apply_param_modifiers(found, spec)
    model.dof_frictionloss[:], friction = 0.0, model.dof_frictionloss.copy()
    data = mujoco.MjData(model)
    s = held.setting
    needed = np.empty_like(s.q)
    for k in range(len(s.q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = s.q[k], s.v[k], s.a[k]
        mujoco.mj_inverse(model, data)
        needed[k] = data.qfrc_inverse
    return held.reduce(s.torque - needed - friction * s.sign)
