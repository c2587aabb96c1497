"""MuJoCo's flex as the cloth of a garment of one layer (optional extra `peers`).

Mesh, areal mass, membrane modulus Y, flexural rigidity B and friction are the same as in foldcell's own solver.
MuJoCo's shell is a plate of Young modulus E and thickness t with Y = E t and B = E t^3 / (12 (1 - nu^2)), so
t = sqrt(12 (1 - nu^2) B / Y). Contacts use another thickness.

Pads hold material points. Each coordinate of such a point is a linear function of vertex coordinates. MuJoCo
models this function as a fixed tendon, and an equality constraint ties the tendon to the hand. Each grip therefore
compiles a new model and copies the state of the old model. Hands are capsules without friction, because kinematic
bodies of MuJoCo have no velocity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from foldcell.robots.errors import InternalError
from foldcell.skills.cloth.elasticity import GRAVITY, flexural_rigidity, membrane_modulus
from foldcell.skills.cloth.mesh import ClothMesh
from foldcell.skills.cloth.pinch import PadGeometry, PinchReport, find_pinched
from foldcell.skills.vocabulary import Array, Material

POISSON = 1.0 / 3.0
HANDS, CAPSULES = 2, 6
LONGEST = 0.06  # largest half length of a capsule's axis [m]
AWAY = 50.0  # coordinate of unused capsules [m]
CLOSING = 0.12  # time in which closing pads draw the cloth to their middle [s]
HOLD_SOLREF = (0.004, 1.0)
HAND_SOLREF = "0.01 1"
STILL = 5e-5  # cloth is at rest if no coordinate changes by more than this [m]
STILL_FRAMES = 15  # cloth is not computed after this number of frames at rest, until a capsule comes near
NEAR = 0.02  # a capsule closer than this wakes cloth at rest [m]


@dataclass(frozen=True)
class MujocoSettings:
    """Settings of the solver.

    frame_rate [1/s]; steps: MuJoCo's steps per frame. solref: time constant [s] of contacts (damping ratio 1).
    With MuJoCo's default of 0.02 s, cloth creeps by centimetres during a fold. iterations, tolerance: limits
    of MuJoCo's solver. damping [s]: damping of the shell. gravity [m/s2]. selfcollide: whether cloth collides
    with itself. rest: whether the solver skips cloth at rest.
    """

    frame_rate: int = 60
    steps: int = 5
    solref: float = 0.007
    iterations: int = 30
    tolerance: float = 1e-8
    damping: float = 0.002
    gravity: tuple[float, float, float] = (0.0, 0.0, -GRAVITY)
    selfcollide: bool = True
    rest: bool = True

    @property
    def step(self) -> float:
        """Time step [s]."""
        return 1.0 / (self.frame_rate * self.steps)


@dataclass(eq=False)
class _Hold:
    """The cloth that one hand holds. vertex, bary: (m, 3) vertices and barycentric weights of m material points;
    offset: (m, 3) their positions in the tool frame when the pads closed [m]; height: (m,) the heights at which
    the pads hold them [m]. age: time since the pads closed [s]; limit, force: largest and present force [N]; rows:
    indices of the 3 m equality constraints in the model."""

    vertex: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    bary: Array = field(default_factory=lambda: np.zeros((0, 3)))
    offset: Array = field(default_factory=lambda: np.zeros((0, 3)))
    height: Array = field(default_factory=lambda: np.zeros(0))
    age: float = 0.0
    limit: float = 0.0
    force: Array = field(default_factory=lambda: np.zeros(3))
    rows: slice = field(default_factory=lambda: slice(0, 0))

    def targets(self, x: Array, position: Array, rotation: Array) -> Array:
        """Return target positions (m, 3) of the points, for vertices x (n, 3). The layers keep their distances.
        The stack can turn freely about the line along which the pads hold it."""
        mean = self.height.mean()
        r = self.height - mean
        at = (np.einsum("kj,kjd->kd", self.bary, x[self.vertex]) - position) @ rotation
        along, across = r @ (at[:, 2] - mean), r @ at[:, 1]
        size = float(np.hypot(along, across))
        c, s = (along / size, across / size) if size > 1e-12 else (1.0, 0.0)
        ramp = max(0.0, 1.0 - self.age / CLOSING)
        final = np.column_stack((self.offset[:, 0], s * r, mean + c * r))
        return np.asarray(position + (final + ramp * (self.offset - final)) @ rotation.T)


class MujocoCloth:
    """One sheet of cloth on the table: a `ClothBody`.

    positions: (n, 3) at the start, at rest; fixed: vertices that stay at their flat positions; table: whether
    there is a table. Raises InternalError if MuJoCo's state becomes invalid.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        material: Material,
        positions: Array | None = None,
        settings: MujocoSettings | None = None,
        table: bool = True,
        pads: PadGeometry | None = None,
        fixed: Sequence[int] = (),
    ) -> None:
        self.mesh, self.material = mesh, material
        self.settings, self.pads = settings or MujocoSettings(), pads or PadGeometry()
        self._flat = mesh.lay_flat(material.thickness)
        self._free = np.ones(len(self._flat), dtype=bool)
        self._free[list(fixed)] = False
        self._xml = _xml(mesh, material, self._flat, self.settings, table, fixed)
        self._holds = [_Hold() for _ in range(HANDS)]
        self._position = np.zeros((HANDS, 3))
        self._rotation = np.tile(np.diag([1.0, -1.0, -1.0]), (HANDS, 1, 1))
        self._resting, self._still = self._flat, 0
        self._build()
        self.set_positions(self._flat if positions is None else positions)

    def _build(self) -> None:
        """Compile the model with the present holds and copy the state of the old model."""
        old = getattr(self, "_data", None)
        self._model = _compile(self._xml, self.material, self.mesh, self._free, self._flat, self._holds)
        self._data = mujoco.MjData(self._model)
        self._capsule = [self._model.geom(f"k{k}").id for k in range(CAPSULES)]
        self._take_away(range(CAPSULES))
        if old is not None:
            self._data.qpos[:], self._data.qvel[:] = old.qpos, old.qvel
            self._data.mocap_pos[:], self._data.mocap_quat[:] = old.mocap_pos, old.mocap_quat
        self._wake()

    @property
    def positions(self) -> Array:
        x = self._flat.copy()
        x[self._free] += self._data.qpos.reshape(-1, 3)
        return x

    def set_positions(self, positions: Array) -> None:
        """Set the vertices (n, 3), at rest. Releases both hands."""
        for hand in range(HANDS):
            self.release(hand)
        self._data.qpos[:] = (positions - self._flat)[self._free].ravel()
        self._data.qvel[:] = 0.0
        self._wake()

    # hands

    def grip(self, hand: int, position: Array, rotation: Array, force: float = 20.0) -> PinchReport:
        p, r = np.asarray(position, dtype=float), np.asarray(rotation, dtype=float)
        found = find_pinched(self.mesh, self.positions, p, r, self.pads, self.material.thickness)
        self._holds[hand] = _Hold(found.vertex, found.bary, found.offset, found.height)
        self.set_grip_force(hand, force)
        self._position[hand], self._rotation[hand] = p, r
        self._build()
        return found.report

    def release(self, hand: int) -> None:
        hold = self._holds[hand]
        self._data.eq_active[hold.rows] = 0
        self._holds[hand] = _Hold()
        self._wake()

    def set_grip_force(self, hand: int, force: float) -> None:
        self._holds[hand].limit = 2.0 * self.pads.friction * force

    def held(self, hand: int) -> bool:
        return len(self._holds[hand].vertex) > 0

    def press(self, pressure: Array) -> None:
        """Nothing: this cloth keeps no creases."""

    def pinch_force(self, hand: int) -> Array:
        return self._holds[hand].force.copy()

    # time

    def advance(self, frames: int = 1) -> None:
        p, r = np.repeat(self._position[None], frames + 1, 0), np.repeat(self._rotation[None], frames + 1, 0)
        self.advance_along(p, r)

    def advance_along(
        self, position: Array, rotation: Array, capsules: tuple[Array, Array, Array] | None = None
    ) -> None:
        for f in range(len(position) - 1):
            ends = None if capsules is None else (capsules[0][f : f + 2], capsules[1][f : f + 2], capsules[2])
            self._frame(position[f : f + 2], rotation[f : f + 2], ends)
        self._position, self._rotation = np.array(position[-1]), np.array(rotation[-1])

    def _frame(self, position: Array, rotation: Array, capsules: tuple[Array, Array, Array] | None) -> None:
        if self._at_rest(capsules):
            return
        used = 0 if capsules is None else len(capsules[2])
        self._take_away(range(used, CAPSULES))
        forces = [np.zeros(3) for _ in range(HANDS)]
        for k in range(self.settings.steps):
            s = (k + 1) / self.settings.steps
            if capsules is not None:
                low, high = ((1.0 - s) * ends[0] + s * ends[1] for ends in capsules[:2])
                self._place(low, high, capsules[2])
            x = self.positions
            for hand, hold in enumerate(self._holds):
                if self.held(hand):
                    hold.age += self.settings.step
                    p, r = ((1.0 - s) * ends[0, hand] + s * ends[1, hand] for ends in (position, rotation))
                    self._tie(hold, hold.targets(x, p, r))
            mujoco.mj_step(self._model, self._data)
            for hand, hold in enumerate(self._holds):
                forces[hand] += self._pull(hold) / self.settings.steps
        if not np.isfinite(self._data.qpos).all() or self._data.warning.number[mujoco.mjtWarning.mjWARN_BADQACC]:
            raise InternalError("MuJoCo's state of the cloth is invalid", time_s=float(self._data.time))
        for hand, hold in enumerate(self._holds):
            hold.force = forces[hand]
            if self.held(hand) and np.linalg.norm(forces[hand]) > hold.limit:
                self.release(hand)

    def _tie(self, hold: _Hold, targets: Array) -> None:
        rest = np.einsum("kj,kjd->kd", hold.bary, self._flat[hold.vertex])
        self._model.eq_data[hold.rows, 0] = (targets - rest).ravel()

    def _pull(self, hold: _Hold) -> Array:
        """Return the force (3,) [N] of the cloth on the hand in the last step."""
        data = self._data
        mine = (data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY) & (data.efc_id >= hold.rows.start)
        mine &= data.efc_id < hold.rows.stop
        return -np.asarray(data.efc_force[mine]).reshape(-1, 3).sum(axis=0)

    def _at_rest(self, capsules: tuple[Array, Array, Array] | None) -> bool:
        """Whether the cloth is at rest and nothing moves it in this frame."""
        x = self.positions
        touched = capsules is not None and _within(x, *capsules, NEAR)
        if not self.settings.rest or touched or any(self.held(hand) for hand in range(HANDS)):
            self._wake()
        elif np.abs(x - self._resting).max() > STILL:
            self._resting, self._still = x, 0
        else:
            self._still += 1
        if self._still < STILL_FRAMES:
            return False
        self._data.qvel[:] = 0.0
        return True

    def _wake(self) -> None:
        self._resting, self._still = self.positions, 0

    def _place(self, low: Array, high: Array, radius: Array) -> None:
        """Place capsules with axes from low to high (k, 3) and radius (k,)."""
        for k, (p0, p1) in enumerate(zip(low, high, strict=True)):
            length = float(np.linalg.norm(p1 - p0))
            quaternion = np.zeros(4)
            mujoco.mju_quatZ2Vec(quaternion, (p1 - p0) / length)
            self._data.mocap_pos[k], self._data.mocap_quat[k] = 0.5 * (p0 + p1), quaternion
            # never larger than in the compiled model, so that the bounds of the broad phase stay valid
            self._model.geom_size[self._capsule[k], :2] = radius[k], min(0.5 * length, LONGEST)

    def _take_away(self, capsules: Sequence[int]) -> None:
        for k in capsules:
            self._data.mocap_pos[k] = (AWAY, 0.0, AWAY + k)

    # checkpoints

    def checkpoint(self) -> dict[str, Array]:
        out = {"tool_p": self._position.copy(), "tool_r": self._rotation.copy(), "still": np.array(self._still),
               "place": self._resting.copy()}  # fmt: skip
        state = np.zeros(mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(self._model, self._data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        out["state"], out["eq_data"] = state, np.array(self._model.eq_data)
        for hand, hold in enumerate(self._holds):
            for name in ("vertex", "bary", "offset", "height", "age", "limit", "force"):
                out[f"hold{hand}.{name}"] = np.array(getattr(hold, name))
        return out

    def restore(self, saved: Mapping[str, NDArray]) -> None:
        if saved["place"].shape != self._flat.shape:
            raise InternalError("the checkpoint belongs to another mesh", shape=tuple(saved["place"].shape))
        self._holds = []
        for hand in range(HANDS):
            part = {k.split(".")[1]: v.copy() for k, v in saved.items() if k.startswith(f"hold{hand}.")}
            points = part["vertex"], part["bary"], part["offset"], part["height"]
            self._holds.append(_Hold(*points, float(part["age"]), float(part["limit"]), part["force"]))
        self._build()
        self._model.eq_data[:] = saved["eq_data"]
        mujoco.mj_setState(self._model, self._data, saved["state"], mujoco.mjtState.mjSTATE_INTEGRATION)
        self._position, self._rotation = saved["tool_p"].copy(), saved["tool_r"].copy()
        self._resting, self._still = saved["place"].copy(), int(saved["still"])


def _within(x: Array, low: Array, high: Array, radius: Array, margin: float) -> bool:
    """Whether a point of x (n, 3) is within `margin` [m] of a capsule at the start or the end of a frame."""
    for p0, p1, r in zip(low.reshape(-1, 3), high.reshape(-1, 3), np.tile(radius, len(low)), strict=True):
        axis = p1 - p0
        s = np.clip((x - p0) @ axis / (axis @ axis), 0.0, 1.0)
        if np.min(np.linalg.norm(x - p0 - s[:, None] * axis, axis=1)) < r + margin:
            return True
    return False


def _compile(
    xml: str, material: Material, mesh: ClothMesh, free: NDArray[np.bool_], flat: Array, holds: Sequence[_Hold]
) -> mujoco.MjModel:
    """Compile the model: each vertex has the mass of its area, and each hold has its equalities."""
    spec = mujoco.MjSpec.from_string(xml)
    mass = material.areal_mass * mesh.vertex_area
    bodies = {v: spec.body(f"c_{v}") for v in np.flatnonzero(free)}
    for v, body in bodies.items():
        body.inertia = body.inertia * (mass[v] / body.mass)
        body.mass = mass[v]
        for axis, joint in zip("xyz", body.joints, strict=True):
            joint.name = f"{axis}{v}"
    row = 0
    for hold in holds:
        hold.rows = slice(row, row + 3 * len(hold.vertex))
        for vertices, weights in zip(hold.vertex, hold.bary, strict=True):
            for axis in "xyz":
                tendon = spec.add_tendon(name=f"t{row}")
                for v, weight in zip(vertices, weights, strict=True):
                    tendon.wrap_joint(f"{axis}{v}", float(weight))
                equality = spec.add_equality(name=f"e{row}", type=mujoco.mjtEq.mjEQ_TENDON, name1=f"t{row}")
                equality.objtype = mujoco.mjtObj.mjOBJ_TENDON
                equality.solref = HOLD_SOLREF
                row += 1
    return spec.compile()


def _xml(
    mesh: ClothMesh, material: Material, flat: Array, settings: MujocoSettings, table: bool, fixed: Sequence[int]
) -> str:
    modulus, rigidity = membrane_modulus(material), flexural_rigidity(material)
    plate = float(np.sqrt(12.0 * (1.0 - POISSON**2) * rigidity / modulus))
    contact = f'condim="3" solref="{settings.solref} 1"'
    ground = f'<geom type="plane" size="3 3 .1" friction="{material.friction_static} 0 0" priority="1" {contact}/>'
    hands = "".join(
        f'<body name="k{k}" mocap="true"><geom name="k{k}" type="capsule" size="0.05 {LONGEST}" condim="1"'
        f' priority="2" solref="{HAND_SOLREF}" contype="2" conaffinity="1"/></body>'
        for k in range(CAPSULES)
    )
    pins = f'<pin id="{" ".join(map(str, fixed))}"/>' if len(fixed) else ""
    return f"""<mujoco>
<option timestep="{settings.step}" gravity="{_text(np.array(settings.gravity))}" integrator="discrete"
 solver="CG" cone="elliptic" impratio="10" iterations="{settings.iterations}" tolerance="{settings.tolerance}"/>
<size memory="500M"/>
<worldbody>{ground if table else ""}{hands}
<flexcomp name="c" type="direct" dim="2" point="{_text(flat.ravel())}" element="{_text(mesh.triangles.ravel())}"
 radius="{0.5 * material.thickness}" mass="{material.areal_mass * float(mesh.area.sum())}">
<elasticity young="{modulus / plate}" poisson="{POISSON}" thickness="{plate}" damping="{settings.damping}"
 elastic2d="both"/>
<contact friction="{material.friction_layers} 0 0" selfcollide="{"auto" if settings.selfcollide else "none"}"
 {contact}/>{pins}</flexcomp></worldbody></mujoco>"""


def _text(values: Array | NDArray[np.int32]) -> str:
    return " ".join(f"{v:.12g}" for v in values)
