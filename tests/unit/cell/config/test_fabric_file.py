"""Fabrics of the shipped garments against the ranges of their classes, and the fabrics that worlds draw."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from benchmarks.cloth.meshes import smallest_angle
from foldcell.cell.config.garments.fabric_file import PATH, load_fabrics
from foldcell.cell.config.garments.garment_file import list_garments, load_garment
from foldcell.cell.config.yaml_file import read_yaml
from foldcell.cell.simulation.garment.garment import WorldGarment
from foldcell.cell.simulation.noise import load_noise
from foldcell.skills.cloth.elasticity import flexural_rigidity

GARMENTS = {name: load_garment(name) for name in list_garments()}
PROPERTIES = ("areal_mass", "bending_length", "thickness", "friction_layers")


@pytest.mark.parametrize("name", list(GARMENTS))
def test_the_fabric_lies_within_the_ranges_of_its_class(name: str) -> None:
    garment = GARMENTS[name]
    assert garment.fabric is not None
    for quantity in PROPERTIES:
        low, high = getattr(garment.fabric, quantity)
        assert low <= getattr(garment.material, quantity) <= high, quantity


def test_every_class_has_an_ordered_range_with_unit_and_source_for_each_property() -> None:
    for name, entry in read_yaml(PATH, "file of fabrics").data.items():
        assert set(entry) == {"title", *PROPERTIES, "bending_ratio"}, name
        for quantity in (*PROPERTIES, "bending_ratio"):
            assert set(entry[quantity]) == {"range", "unit", "source"}, (name, quantity)
            low, high = entry[quantity]["range"]
            assert 0.0 < low <= high, (name, quantity)


def test_every_range_has_a_source() -> None:
    for fabric in load_fabrics().values():
        assert all(len(source.strip()) > 0 for source in fabric.sources.values())
        assert set(PROPERTIES) | {"bending_ratio"} == set(fabric.sources)


def test_within_a_class_rigidity_does_not_fall_with_areal_mass() -> None:
    classes = defaultdict(list)
    for garment in GARMENTS.values():
        assert garment.fabric is not None
        classes[garment.fabric.name].append((garment.material.areal_mass, flexural_rigidity(garment.material)))
    for fabrics in classes.values():
        rigidities = [rigidity for _, rigidity in sorted(fabrics)]
        assert np.all(np.diff(rigidities) >= -1e-12)


@pytest.mark.parametrize("name", ["jeans", "small_towel"])
def test_worlds_draw_the_whole_range_of_the_class(name: str) -> None:
    garment, noise = GARMENTS[name], load_noise().garment
    assert garment.fabric is not None
    drawn = [WorldGarment(garment, noise, np.random.default_rng(seed), False) for seed in range(16)]
    for quantity in ("bending_length", "thickness", "friction_layers"):
        low, high = getattr(garment.fabric, quantity)
        values = np.array([getattr(world.material, quantity) for world in drawn])
        assert low <= values.min() and values.max() <= high
        assert np.ptp(values) > 0.6 * (high - low)
    rigidity = [flexural_rigidity(world.material) for world in drawn]
    assert max(rigidity) / min(rigidity) > 2.0


@pytest.mark.parametrize("name", list(GARMENTS))
def test_the_mesh_of_a_world_resolves_its_creases(name: str) -> None:
    world = WorldGarment(GARMENTS[name], load_noise().garment, np.random.default_rng(4), False)
    c = world.material.bending_length
    shortest, typical = np.quantile(world.mesh.edge_length, [0.02, 0.10])
    assert typical <= 0.7 * c and shortest > 0.3 * c
    assert smallest_angle(world.mesh) > np.deg2rad(12.0)
