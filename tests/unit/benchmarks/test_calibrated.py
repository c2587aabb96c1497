"""The paper's tests of a fabric, performed in simulation for the smallest of its garments."""

from benchmarks.cloth.calibrated import friction, hung


def test_the_virtual_garment_stretches_and_slides_as_the_paper_measured() -> None:
    stretched = hung(quick=True, tell=lambda text: None)
    assert stretched["calibrated_garments"] == 1 and stretched["hang_garment_error_pp_max"] < 0.1
    slid = friction(quick=True, tell=lambda text: None)
    assert slid["friction_garments"] == 1 and slid["friction_calibration_error_rel_max"] < 0.02
