"""The independent cloth itself, where the optional extra is installed."""

import pytest

pytest.importorskip("mujoco")


def test_mujocos_cloth_slides_and_hangs_as_the_closed_forms():
    from benchmarks.cloth import mujoco_peer

    figures = {}
    mujoco_peer.tilt(figures, (0.6,))
    mujoco_peer.hang(figures, (0.02,), (0.026,))
    assert figures["mujoco_tilt_slide_error_rel_max"] < 0.02
    assert figures["mujoco_hang_error_pp_max"] < 0.4
