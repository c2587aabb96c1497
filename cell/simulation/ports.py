"""The simulated cell's ports: each knows the number of its cell and nothing else.

What a number stands for is in `cell.simulation._registry`, so that no attribute of anything that an executive
holds leads to the world.
"""

from __future__ import annotations

from cell.simulation import _registry
from robots.baxter.pybullet_body import MAX_OPENING
from robots.ports import (
    Array,
    BoardPlace,
    CameraFrame,
    GripperState,
    JointSetpoint,
    JointState,
    Ports,
    Side,
    StopState,
    TactileReading,
)

__all__ = ["ports_of"]


class _Port:
    __slots__ = ("_cell",)

    def __init__(self, cell: int) -> None:
        self._cell = cell


class _Clock(_Port):
    __slots__ = ()

    def now(self) -> float:
        return _registry.world(self._cell).now()

    def sleep_until(self, t: float) -> None:
        _registry.world(self._cell).sleep_until(t)


class _Arms(_Port):
    __slots__ = ("command_timeout",)

    def __init__(self, cell: int, command_timeout: float) -> None:
        super().__init__(cell)
        self.command_timeout = command_timeout

    def state(self) -> JointState:
        return _registry.world(self._cell).robot.state()

    def enable(self) -> None:
        _registry.world(self._cell).robot.enable()

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        return _registry.world(self._cell).robot.command(q, qd)


class _Head(_Port):
    __slots__ = ()

    def command_pan(self, angle: float) -> None:
        _registry.world(self._cell).robot.command_pan(angle)


class _Sided(_Port):
    __slots__ = ("side",)

    def __init__(self, cell: int, side: Side) -> None:
        super().__init__(cell)
        self.side = side


class _Gripper(_Sided):
    __slots__ = ("max_opening",)

    def __init__(self, cell: int, side: Side) -> None:
        super().__init__(cell, side)
        self.max_opening = MAX_OPENING

    def calibrate(self) -> None:
        _registry.world(self._cell).gripper(self.side).calibrate()

    def command(self, opening: float, force: float) -> None:
        _registry.world(self._cell).gripper(self.side).command(opening, force)

    def state(self) -> GripperState:
        return _registry.world(self._cell).gripper(self.side).state()


class _Tactile(_Sided):
    __slots__ = ()

    def reading(self) -> TactileReading:
        world = _registry.world(self._cell)
        return world.tactile(self.side).reading(world.now())


class _Camera(_Port):
    __slots__ = ()

    def capture(self) -> CameraFrame:
        return _registry.world(self._cell).capture()

    def glimpse(self) -> CameraFrame:
        return _registry.world(self._cell).glimpse()


class _Stop(_Port):
    __slots__ = ()

    def trigger(self, reason: str) -> None:
        _registry.world(self._cell).robot.trigger_stop(reason)

    def state(self) -> StopState:
        return _registry.world(self._cell).robot.stop_state()

    def reset(self) -> None:
        _registry.world(self._cell).robot.reset_stop()


class _Attendant(_Port):
    __slots__ = ()

    def lay_garment(self) -> None:
        _registry.world(self._cell).lay_garment()

    def bring_board(self, place: BoardPlace) -> None:
        _registry.world(self._cell).bring_board(place)


def ports_of(cell: int, command_timeout: float) -> Ports:
    """The ports of the cell with this number. command_timeout [s]: of its arms."""
    return Ports(
        driver="sim",
        simulated=True,
        clock=_Clock(cell),
        arms=_Arms(cell, command_timeout),
        head=_Head(cell),
        grippers={side: _Gripper(cell, side) for side in Side},
        tactile={side: _Tactile(cell, side) for side in Side},
        camera=_Camera(cell),
        stop=_Stop(cell),
        attendant=_Attendant(cell),
    )
