"""`foldcell calibrate shear|friction|bending|crease`: the written garment file, and refused input."""

import json
import math

import pytest
import yaml

from foldcell.cell.commands.main import main
from foldcell.cell.config.garments.garment_file import load_garment, shipped_garment_path
from foldcell.cell.config.garments.material_file import with_material
from foldcell.robots.errors import ConfigurationError
from foldcell.skills.vocabulary import REFERENCE_DROP

SHIPPED = shipped_garment_path("small_towel").read_text()


@pytest.fixture
def call(tmp_path, capsys):
    def run(*arguments):
        code = main(["calibrate", *map(str, arguments), "--logs", str(tmp_path / "logs"), "--json"])
        lines = capsys.readouterr().out.strip().splitlines()
        return code, json.loads(lines[-1])

    return run


def test_calibrate_friction_writes_a_garment_file_and_a_recording(call, tmp_path):
    out = tmp_path / "mine.yaml"
    code, told = call("friction", "small_towel", "--height", 0.3, "--length", 0.8, "--output", out)
    assert code == 0 and told["agrees"] and told["simulated"]
    assert (tmp_path / "logs").is_dir() and told["recording"].endswith("test.rrd")
    assert told["simulated_friction"] == pytest.approx(0.375 / math.sqrt(1 - 0.375**2), rel=0.02)
    fabric = load_garment(out).material
    assert fabric.friction_static == pytest.approx(told["friction"], rel=1e-4)
    old, new = yaml.safe_load(SHIPPED), yaml.safe_load(out.read_text())
    assert "0.8 m long lifted by 0.3 m" in new["material"]["measured"].pop("friction_bare_table")
    new["material"]["friction_angle_deg"] = old["material"]["friction_angle_deg"]
    assert new == old
    assert next(line for line in SHIPPED.splitlines() if line.startswith("#")) in out.read_text()
    # an existing file is overwritten only with --replace
    before = out.read_text()
    code, told = call("friction", out, "--height", 0.3, "--length", 0.8, "--output", out)
    assert code == 64 and "--replace" in told["hint"] and out.read_text() == before


def test_a_measured_bending_length_is_not_marked_as_assumed(call, tmp_path):
    code, told = call("bending", "small_towel", "--overhang", 0.036)
    assert code == 0
    fabric = load_garment(told["file"]).material
    assert fabric.bending_length == 0.018 and "bending_length" not in fabric.assumed
    assert "thickness" in fabric.assumed


def test_a_free_fold_gives_the_bending_length(call):
    thickness = load_garment("small_towel").material.thickness
    code, told = call("bending", "small_towel", "--fold-height", 0.907 * 0.016 + 1.5 * thickness, "--mass", 0.38)
    assert code == 0 and told["agrees"]
    fabric = load_garment(told["file"]).material
    assert fabric.bending_length == pytest.approx(0.016, rel=2e-3) and fabric.areal_mass == 0.38
    assert not {"bending_length", "areal_mass"} & set(fabric.assumed)


def test_a_crease_test_writes_the_set_of_the_fabric(call):
    code, told = call("crease", "vest", "--angle", 80, "--load", 0.5, "--time", 300)
    assert code == 0 and told["agrees"] and told["pressure_pa"] == pytest.approx(18.17e3, rel=1e-3)
    assert told["simulated_kept_angle_deg"] == pytest.approx(80.0, abs=3.0)
    fabric, before = load_garment(told["file"]).material, load_garment("vest").material
    assert 0.2 < fabric.crease_set < before.crease_set
    assert fabric.crease_set == pytest.approx(told["crease_set"], abs=1e-4)
    assert "crease_set" in before.assumed and "crease_set" not in fabric.assumed


def test_calibrate_shear_writes_the_stretch_of_the_reference_strip(call):
    code, told = call("shear", "small_towel", "--l1", 0.5275, "--l2", 0.516)
    assert code == 0 and told["agrees"]
    fabric = load_garment(told["file"]).material
    assert fabric.stretch_fraction == pytest.approx(told["strip_stretch_fraction"], rel=1e-3)
    assert fabric.stretch_fraction == pytest.approx(
        told["stretch_fraction"] * REFERENCE_DROP / told["hang_drop_m"], rel=1e-3
    )


@pytest.mark.parametrize(
    "line",
    [
        ("shear", "small_towel", "--l1", 0.5, "--l2", 0.6),
        ("shear", "small_towel", "--l1", 1.02, "--l2", 1.0),
        ("shear", "small_towel", "--l1", 0.5275, "--l2", 0.516, "--held", "collar"),
        ("friction", "small_towel", "--height", 1, "--length", 0.8),
        ("bending", "small_towel", "--overhang", "nan"),
        ("bending", "small_towel", "--fold-height", 0.9),
        ("bending", "small_towel", "--fold-height", 0.018, "--mass", 5.0),
        ("bending", "small_towel", "--overhang", 0.04, "--mass", 0.4),
        ("crease", "vest", "--angle", 200, "--load", 0.5, "--time", 300),
        ("bending", "no_such_garment", "--overhang", 0.04),
        ("bending", "small_towel", "--overhang", 0.04, "--output", shipped_garment_path("small_towel")),
        ("bending", "small_towel", "--overhang", 0.04, "--output", "/no/such/folder/x.yaml"),
        ("bending", "small_towel", "--overhang", 0.04, "--output", "x.txt"),
    ],
)
def test_a_bad_call_is_refused_and_writes_nothing(call, tmp_path, line):
    code, told = call(*line)
    assert code == 64 and told["error"]
    assert not list(tmp_path.rglob("*.yaml")) and not list(tmp_path.rglob("*.rrd"))
    assert shipped_garment_path("small_towel").read_text() == SHIPPED


@pytest.mark.parametrize(
    "material",
    [
        "material:\n  friction_angle_deg:\n    bare_table: 20.0\n    felt: 30.0  # kept\n  thickness: 0.002\n",
        "material: {friction_angle_deg: {bare_table: 20.0, felt: 30.0}, thickness: 0.002}\n",
        "",
    ],
)
def test_garment_files_of_any_layout_can_be_edited(material):
    data = yaml.safe_load(SHIPPED)
    del data["material"]
    text = material + yaml.safe_dump(data, sort_keys=False)
    edited = with_material(
        text, "mine", {"friction_angle_deg": {"felt": 25.0}}, {"friction_felt": "so"}, (), "felt"
    )
    found = yaml.safe_load(edited)
    assert found["material"]["friction_angle_deg"]["felt"] == 25.0
    if material:
        assert found["material"]["friction_angle_deg"]["bare_table"] == 20.0
        assert found["material"]["thickness"] == 0.002
    assert {k: v for k, v in found.items() if k != "material"} == data


def test_an_edit_preserves_layout_and_unindented_comments():
    text = SHIPPED.replace("material:\n", "material:\n# measured on the bench\n")
    edited = with_material(text, "mine", {"thickness": 0.003}, {"thickness": "a gauge"}, ())
    assert "# measured on the bench" in edited and len(edited.splitlines()) == len(text.splitlines())


def test_a_value_out_of_range_writes_no_file():
    with pytest.raises(ConfigurationError):
        with_material(SHIPPED, "mine", {"bending_length": 3.0}, {}, ())
