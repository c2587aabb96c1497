"""A separate ROS master for this program. Its process ends together with the process that started it.

python -m foldcell.cell.simulation.emulator.ros_master PORT      runs until standard input ends
"""

from __future__ import annotations

import os
import signal
import sys

from foldcell.robots.ros.installation import import_ros


def main() -> None:
    import_ros("rosmaster.master").Master(int(sys.argv[1])).start()
    print("ready", flush=True)
    while sys.stdin.buffer.read(1):
        pass
    os._exit(0)  # the server's threads never end


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    main()
