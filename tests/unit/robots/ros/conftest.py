"""A puppet robot, and a driver connected to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from puppet import CAMERA, COMMANDS, Connect, Puppet, wait

from foldcell.robots.baxter.ros.connection import connected
from foldcell.robots.model import JointLimits
from foldcell.robots.ports import BoardPlace, Ports
from foldcell.robots.ros.driver import CameraTopics, RosSettings
from foldcell.robots.ros.node import Node, open_node


class Person:
    def lay_garment(self) -> None: ...

    def bring_board(self, place: BoardPlace) -> None: ...


@pytest.fixture
def puppet(rosmaster: str) -> Iterator[Puppet]:
    made = Puppet()
    yield made
    made.close()


@pytest.fixture
def limits() -> JointLimits:
    upper = np.linspace(1.0, 1.65, 14)
    velocity = np.linspace(1.0, 2.3, 14)
    return JointLimits(-upper - 0.1, upper, velocity, velocity * 3.0, velocity * 30.0)


@pytest.fixture
def connect(puppet: Puppet, limits: JointLimits) -> Connect:
    @contextmanager
    def opened(**settings: Any) -> Iterator[Ports]:
        chosen = RosSettings(camera=CameraTopics(**CAMERA), **{"camera_settle": 0.0, **settings})
        with connected(chosen, limits, lambda stop: Person(), driver="ros", simulated=False) as ports:
            wait(lambda: all(puppet.hears(topic) for topic in COMMANDS), "its commands are heard")
            yield ports

    return opened


@pytest.fixture
def ports(connect: Connect) -> Iterator[Ports]:
    with connect() as opened:
        yield opened


@pytest.fixture
def node(puppet: Puppet) -> Iterator[Node]:
    opened = open_node("driver")
    yield opened
    opened.close()
