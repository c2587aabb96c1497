"""The commands of a run as arrays, read from its transcript."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.transcript.transcript import Transcript
from cell.transcript.transcript_codec import Channel, unpack
from robots.errors import StorageError
from robots.ports import Array, JointSetpoint, frozen

__all__ = ["SetPoints", "read_set_points"]


@dataclass(frozen=True, eq=False)
class SetPoints:
    """All commands of a run to arms, grippers and head. The time of a command is the cell time that the executive
    last read before it, or until which it last slept [s].

    t: (n,) [s], not decreasing. q, qd: (n, joints) as the executive requested them [rad], [rad/s]: the left arm's
    joints from shoulder to wrist, then the right arm's; (0, 0) without commands. clipped: (n,) bool, whether the
    driver clipped the request. grippers: 'left' and 'right' -> (k, 3), rows of time [s], opening between the pads
    [m], force limit [N]. head: (m, 2), rows of time [s], pan angle [rad].
    """

    t: Array
    q: Array
    qd: Array
    clipped: NDArray[np.bool_]
    grippers: Mapping[str, Array]
    head: Array


def read_set_points(transcript: Transcript) -> SetPoints:
    """Read the commands up to the end of the transcript, without commands that a driver refused. Raises
    StorageError for a damaged transcript."""
    now = 0.0
    arms: list[tuple[float, Array, Array, bool]] = []
    grippers: dict[str, list[tuple[float, ...]]] = {side.value: [] for side, _ in transcript.constants.max_opening}
    head: list[tuple[float, ...]] = []
    for exchange in transcript:
        try:
            if exchange.channel is Channel.NOW:
                answer = unpack(exchange.answer)
                now = answer if isinstance(answer, float) else now
            elif exchange.channel is Channel.SLEEP:
                now = max(now, *map(float, unpack(exchange.question)))
            elif exchange.channel is Channel.SET_POINT:
                sent = unpack(exchange.answer)
                if isinstance(sent, JointSetpoint):
                    arms.append((now, *unpack(exchange.question), bool(sent.clipped)))
            elif exchange.channel is Channel.GRIP and unpack(exchange.answer) is None:
                side, opening, force = unpack(exchange.question)
                grippers[side.value].append((now, opening, force))
            elif exchange.channel is Channel.HEAD and unpack(exchange.answer) is None:
                head.append((now, *unpack(exchange.question)))
        except (ValueError, KeyError, TypeError) as e:
            raise StorageError(f"the transcript {transcript.path} is damaged: {e}", "read another run") from None
    return SetPoints(
        t=frozen(np.array([row[0] for row in arms], float)),
        q=frozen(np.array([row[1] for row in arms], float).reshape(len(arms), -1 if arms else 0)),
        qd=frozen(np.array([row[2] for row in arms], float).reshape(len(arms), -1 if arms else 0)),
        clipped=frozen(np.array([row[3] for row in arms], bool)),
        grippers={side: frozen(np.array(rows, float).reshape(-1, 3)) for side, rows in grippers.items()},
        head=frozen(np.array(head, float).reshape(-1, 2)),
    )
