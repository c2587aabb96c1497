"""The commands and the measured grip forces of a run as arrays, read from its transcript."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foldcell.cell.transcript.channels import Channel
from foldcell.cell.transcript.transcript import Transcript
from foldcell.cell.transcript.transcript_codec import unpack
from foldcell.robots.ports import Array, JointSetpoint, TactileReading, frozen


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
    grippers: dict[str, list[tuple[float, ...]]] = {side: [] for side in transcript.constants.max_opening}
    head: list[tuple[float, ...]] = []
    for exchange in transcript:
        channel, answer, now = exchange.channel, exchange.answer, exchange.time_after(now)
        if channel is Channel.SET_POINT and isinstance(answer, JointSetpoint):
            arms.append((now, *unpack(exchange.question), answer.clipped))
        elif channel is Channel.GRIP and answer is None:
            side, opening, force = unpack(exchange.question)
            grippers[side].append((now, opening, force))
        elif channel is Channel.HEAD and answer is None:
            head.append((now, *unpack(exchange.question)))
    return SetPoints(
        t=frozen(np.array([row[0] for row in arms], float)),
        q=frozen(np.array([row[1] for row in arms], float).reshape(len(arms), -1 if arms else 0)),
        qd=frozen(np.array([row[2] for row in arms], float).reshape(len(arms), -1 if arms else 0)),
        clipped=frozen(np.array([row[3] for row in arms], bool)),
        grippers={side: frozen(np.array(rows, float).reshape(-1, 3)) for side, rows in grippers.items()},
        head=frozen(np.array(head, float).reshape(-1, 2)),
    )


def read_grips(transcript: Transcript) -> Mapping[str, Array]:
    """Return 'left' and 'right' -> (k, 2), rows of time [s] and grip force [N], one for each reading of a hand's
    pads. Raises StorageError for a damaged transcript."""
    rows: dict[str, list[tuple[float, float]]] = {side: [] for side in transcript.constants.max_opening}
    for exchange in transcript:
        answer = exchange.answer
        if exchange.channel is Channel.TACTILE and isinstance(answer, TactileReading):
            rows[answer.side.value].append((answer.stamp, answer.grip))
    return {side: frozen(np.array(values, float).reshape(-1, 2)) for side, values in rows.items()}
