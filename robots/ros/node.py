"""This process's ROS node.

rospy allows one node per process, for the life of the process. A cell opens and closes its topics on that node,
and the node stays open.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from urllib.parse import urlparse

from foldcell.robots.errors import ConfigurationError
from foldcell.robots.ros.installation import import_ros

MASTER = "http://localhost:11311"
"""Address of the ROS master if ROS_MASTER_URI is not set."""
ANSWER_S = 3.0
CLOSE_S = 3.0

_opened: str | None = None
_opening = threading.Lock()


class Node:
    """The topics of one cell on this process's node. `close` closes all of them."""

    def __init__(self, rospy: Any) -> None:
        self._rospy = rospy
        self._stack = ExitStack()

    def publisher(self, topic: str, kind: Any, *, latch: bool = False) -> Any:
        """Return a rospy.Publisher. Its `publish` may be called from any thread and never blocks."""
        publisher = self._rospy.Publisher(topic, kind, latch=latch, queue_size=1, tcp_nodelay=True)
        self._stack.callback(publisher.unregister)
        return publisher

    def subscribe(self, topic: str, kind: Any, heard: Callable[[Any], None], queue: int = 1) -> None:
        """Call `heard` with each message, on the topic's thread."""
        self._stack.enter_context(self.listening(topic, kind, heard, queue))

    @contextmanager
    def listening(self, topic: str, kind: Any, heard: Callable[[Any], None], queue: int = 1) -> Iterator[None]:
        """Subscribe inside the context."""
        subscriber = self._rospy.Subscriber(topic, kind, heard, queue_size=queue, tcp_nodelay=True)
        try:
            yield
        finally:
            subscriber.unregister()

    def parameter(self, name: str, default: Any) -> Any:
        """Return a value of ROS's parameter server."""
        return self._rospy.get_param(name, default)

    def set_parameter(self, name: str, value: Any) -> None:
        self._rospy.set_param(name, value)

    def delete_parameter(self, name: str) -> None:
        """Delete a parameter, if it exists."""
        if self._rospy.has_param(name):
            self._rospy.delete_param(name)

    @property
    def name(self) -> str:
        """Name of this process's node."""
        return str(self._rospy.get_name())

    def publishers(self, topic: str) -> list[str]:
        """Return the live nodes that publish a topic. The master also lists nodes that have died; they are left
        out."""
        known = self._rospy.get_master().getSystemState()[2][0]
        nodes: list[str] = next((nodes for name, nodes in known if name == topic), [])
        return [node for node in nodes if node == self.name or self._is_alive(node)]

    def _is_alive(self, node: str) -> bool:
        code, _, uri = self._rospy.get_master().lookupNode(node)
        address = _host_and_port(uri) if code == 1 else None
        if address is None:
            return False
        try:
            socket.create_connection(address, ANSWER_S).close()
        except ConnectionError:
            return False
        except OSError:  # unknown host name or no answer: assume that the node is alive
            return True
        return True

    def close(self) -> None:
        """Close all topics. If the master is gone, give up after CLOSE_S."""
        closing = threading.Thread(target=self._stack.close, name="signing off", daemon=True)
        closing.start()
        closing.join(CLOSE_S)


def open_node(name: str) -> Node:
    """Open this process's node. Raises ConfigurationError if ROS is not installed, no master answers, or this
    process is already a node of another master."""
    global _opened
    rospy = import_ros()
    uri, host, port = master_address()
    with _opening:
        if _opened is not None and _opened != uri:
            raise ConfigurationError(
                f"this process is a node of {_opened} and cannot be one of {uri}", "start another process"
            )
        try:
            socket.create_connection((host, port), ANSWER_S).close()
        except OSError as error:
            raise ConfigurationError(
                f"no ROS master answers at {uri}: {error}",
                "switch the robot on and set ROS_MASTER_URI and ROS_IP (this machine's address) as for its SDK",
            ) from error
        if _opened is None:
            # the executive handles signals and uses the cell's clock
            rospy.init_node(name, anonymous=True, disable_signals=True, disable_rosout=True, disable_rostime=True)
            _opened = uri
    return Node(rospy)


def master_address() -> tuple[str, str, int]:
    """Return the master's URI, host and port. Raises ConfigurationError for an invalid URI."""
    uri = os.environ.get("ROS_MASTER_URI") or MASTER
    address = _host_and_port(uri)
    if address is None:
        raise ConfigurationError(f"ROS_MASTER_URI={uri} is not an address", "its form is http://HOST:11311")
    return uri, *address


def _host_and_port(uri: str) -> tuple[str, int] | None:
    """Return the host and port of a URI; None if it is invalid or lacks one of them."""
    try:
        parsed = urlparse(uri)
        host, port = parsed.hostname, parsed.port
        (host or "").encode("idna")  # as it is looked up
    except ValueError:
        return None
    return (host, port) if host and port else None
