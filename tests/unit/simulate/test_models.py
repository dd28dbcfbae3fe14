# SPDX-License-Identifier: Apache-2.0
"""Models of LiDARs: as the documentation lists them, and with errors of the size that it states."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from multilica.simulate import RIGS, models
from multilica.simulate.units import draw_unit

_PAGE = Path(__file__).parents[3] / "docs" / "certainty.md"
_MODELS = {
    "Ouster OS1-64": models.OS1_64,
    "Ouster OS1-128": models.OS1_128,
    "Ouster OS2-128": models.OS2_128,
    "Velodyne VLP-16": models.VLP_16,
    "like Hesai Pandar64": models.ROOF_64,
    "like RoboSense RS-Bpearl": models.SIDE_32,
    "like Seyond Falcon, Livox HAP": models.FALCON,
    "Livox Avia": models.AVIA,
    "Aeva Aeries II": models.AERIES_II,
    "narrow, of no particular make": models.NARROW,
    "solid-state, 70 x 25 deg, of no particular make": models.SOLID_70,
    "solid-state, 25 x 15 deg, of no particular make": models.LONG_25,
}


def _listed() -> dict[str, list[str]]:
    """Return the cells of the table by the name of the model, without marks."""
    table = _PAGE.read_text().partition("## LiDARs of the simulator")[2]
    rows = [re.sub(r"[*`]", "", line).strip("| ").split(" | ") for line in table.splitlines() if line.startswith("| ")]
    return {name: cells for name, *cells in rows[1:]}


def test_the_documentation_lists_every_model_in_use() -> None:
    assert set(_listed()) == set(_MODELS)
    in_use = {mount.sensor for rig in RIGS.values() for mount in rig.mounts}
    assert in_use == set(_MODELS.values())


@pytest.mark.parametrize("name", _MODELS)
def test_the_documentation_has_the_figures_of_the_code(name: str) -> None:
    sensor, accuracy = _MODELS[name], _MODELS[name].accuracy
    rigs, stated, bias, angles, step, beam, dark, noise, nearest = _listed()[name]
    carrying = {rig for rig in RIGS if sensor in {mount.sensor for mount in RIGS[rig].mounts}}
    assert set(rigs.split(", ")) == carrying
    assert accuracy.ring_elevation_deg == accuracy.ring_azimuth_deg
    assert bias == f"{1e3 * accuracy.range_m:.0f}, {1e3 * accuracy.ring_range_m:.0f} mm"
    assert float(stated.removesuffix(" cm")) / 100.0 == pytest.approx(3.0 * accuracy.range_m)
    assert angles == f"{accuracy.ring_elevation_deg:.2f} deg"
    assert beam == f"{sensor.beam_deg:.2f} deg"
    assert (step, noise) == (f"{1e3 * sensor.range_step_m:.0f} mm", f"{1e3 * sensor.range_noise_m:.0f} mm")
    assert (dark, nearest) == (f"{sensor.dark_range_m:.0f} m", f"{sensor.min_range_m} m")


@pytest.mark.parametrize("name", _MODELS)
def test_units_have_the_errors_of_their_model(name: str) -> None:
    """Over many units: no mean, and the stated deviations; the bias of a LiDAR is common to its rings."""
    sensor, accuracy = _MODELS[name], _MODELS[name].accuracy
    rng = np.random.default_rng(0)
    units = [draw_unit(sensor, rng) for _ in range(400)]
    of_ring_m = np.array([unit.range_bias_m for unit in units])
    rings = of_ring_m.shape[1]
    assert rings == sensor.pattern.rings.max() + 1
    expected_m = np.hypot(accuracy.range_m, accuracy.ring_range_m / np.sqrt(rings))
    assert of_ring_m.mean(axis=1).std() == pytest.approx(expected_m, rel=0.15)
    assert abs(of_ring_m.mean()) < 0.2 * expected_m
    assert of_ring_m.std(axis=1, ddof=1).mean() == pytest.approx(accuracy.ring_range_m, rel=0.1)
    for angle, deg in (("elevation", accuracy.ring_elevation_deg), ("azimuth", accuracy.ring_azimuth_deg)):
        values_deg = np.rad2deg([getattr(unit, f"{angle}_rad") for unit in units])
        assert values_deg.std() == pytest.approx(deg, rel=0.1)
        assert abs(values_deg.mean()) < 0.1 * deg
