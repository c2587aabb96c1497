"""The ports of the simulated cell. They have no reference to the world: see cell/simulation/port_worlds.py."""

from __future__ import annotations

from foldcell.cell.simulation.port_worlds import bind, world_behind
from foldcell.cell.simulation.world import World
from foldcell.robots.errors import DriverError, FailureKind
from foldcell.robots.ports import (
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


class _Clock:
    def now(self) -> float:
        return _world(self).port_faults.cell_time()

    def sleep_until(self, t: float) -> None:
        world = _world(self)
        world.sleep_until(world.port_faults.wake_at(t))


class _Arms:
    def __init__(self, command_timeout: float) -> None:
        self.command_timeout = command_timeout

    def state(self) -> JointState:
        world = _world(self)
        return world.port_faults.joint_state(world.robot.state())

    def enable(self) -> None:
        _world(self).robot.enable()

    def command(self, q: Array, qd: Array) -> JointSetpoint:
        world = _world(self)
        if world.port_faults.silence() > self.command_timeout:
            raise DriverError(FailureKind.STALE_STATE, "the positions of the arms are unknown")
        return world.port_faults.stamped(world.robot.command(q, qd, world.port_faults.delivers()))


class _Head:
    def command_pan(self, angle: float) -> None:
        _world(self).robot.command_pan(angle)


class _Sided:
    def __init__(self, side: Side) -> None:
        self.side = side


class _Gripper(_Sided):
    def __init__(self, side: Side, max_opening: float) -> None:
        super().__init__(side)
        self.max_opening = max_opening

    def calibrate(self) -> None:
        world = _world(self)
        world.port_faults.calibrated(self.side)
        world.hands[self.side].gripper.calibrate()

    def command(self, opening: float, force: float) -> None:
        _world(self).hands[self.side].gripper.command(opening, force)

    def state(self) -> GripperState:
        world = _world(self)
        return world.port_faults.gripper(world.hands[self.side].gripper.state())


class _Tactile(_Sided):
    def reading(self) -> TactileReading:
        world = _world(self)
        return world.port_faults.tactile(self.side, lambda side: world.hands[side].tactile.reading(world.now()))


class _Camera:
    def capture(self) -> CameraFrame:
        world = _world(self)
        return world.port_faults.stamped(world.capture())

    def glimpse(self) -> CameraFrame:
        world = _world(self)
        return world.port_faults.stamped(world.glimpse())


class _Stop:
    def trigger(self, reason: str) -> None:
        _world(self).robot.trigger_stop(reason)

    def state(self) -> StopState:
        world = _world(self)
        return world.port_faults.stamped(world.robot.stop_state())

    def reset(self) -> None:
        _world(self).robot.reset_stop()


class _Attendant:
    def lay_garment(self) -> None:
        _world(self).lay_garment()

    def bring_board(self, place: BoardPlace) -> None:
        _world(self).bring_board(place)


def ports_of(world: World) -> Ports:
    """The ports of a world. They work until `unbind`."""
    ports = Ports(
        driver="sim",
        simulated=True,
        clock=_Clock(),
        arms=_Arms(world.noise.robot.command_timeout),
        head=_Head(),
        grippers={side: _Gripper(side, world.hands[side].gripper.max_opening) for side in Side},
        tactile={side: _Tactile(side) for side in Side},
        camera=_Camera(),
        stop=_Stop(),
        attendant=_Attendant(),
    )
    hands = (*ports.grippers.values(), *ports.tactile.values())
    bind((ports.clock, ports.arms, ports.head, *hands, ports.camera, ports.stop, ports.attendant), world)
    return ports


def _world(port: object) -> World:
    world: World = world_behind(port)
    return world
