"""MuJoCo's independent cloth simulation, if the optional extra is installed."""

from tests.optional_parts import MUJOCO

pytestmark = MUJOCO.required


def test_the_mujoco_cloth_agrees_with_the_closed_forms():
    from benchmarks.cloth import mujoco_peer

    figures = {}
    mujoco_peer.tilt(figures, (0.6,))
    mujoco_peer.hang(figures, (0.02,), (0.026,))
    assert figures["mujoco_tilt_slide_error_rel_max"] < 0.02
    assert figures["mujoco_hang_error_pp_max"] < 0.4


def test_both_solvers_fold_a_coarse_towel_alike():
    """Two independent solvers with the same mesh, fabric and pads: the folds agree to a few millimetres."""
    from benchmarks.cloth import mujoco_peer
    from benchmarks.cloth.scenes import SharedFold, mirrored, towel_half, towel_mesh
    from foldcell.skills.cloth.predict import predict_fold

    mesh, material = towel_mesh(110)
    fold = SharedFold(mesh, material, towel_half(), lambda x: mirrored(mesh, material, x))
    ours = predict_fold(mesh, fold.start, material, fold.paths, 0.3, 1.0).vertices
    theirs, _ = mujoco_peer.folded(fold, mujoco_peer.refined(4))
    assert mujoco_peer.apart(ours, theirs) < 4.0
    assert fold.error(theirs) < 0.1 * fold.error(fold.start)
