"""Blockage, diffraction and reflection against geometry and the Fresnel integral."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.special import fresnel

from certnav.datasets.simulation import canyon as street_canyon
from certnav.datasets.simulation.canyon import City, Density, knife_edge_loss
from certnav.datasets.simulation.streets import Block
from certnav.filters.errors import ConfigError

#: A street that runs north, 20 m wide, walls of 32 m on both sides, no gaps.
WALLS = Density((10.0, 10.0), 32.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture
def canyon(monkeypatch):
    monkeypatch.setitem(street_canyon.DENSITIES, "walls", WALLS)
    block = Block((3, 4, 0), 0.0, 200.0, 0.0, 200.0, np.array([-100.0, 0.0]))

    def look(position_t, azimuth_deg, elevation_deg, nlos=1.0, seed=1):
        azimuth, elevation = np.radians(np.broadcast_arrays(azimuth_deg, elevation_deg))
        city = City("walls", seed, nlos)
        shape = (len(position_t), azimuth.size)
        return city.sight(
            (block,),
            np.zeros(len(position_t), dtype=int),
            np.asarray(position_t, dtype=float),
            np.broadcast_to(azimuth, shape),
            np.broadcast_to(elevation, shape),
        )

    return look


def test_knife_edge_is_the_fresnel_integral():
    nu = np.linspace(-0.7, 6.0, 200)
    s, c = fresnel(nu)
    exact = -20.0 * np.log10(np.hypot(1.0 - c - s, c - s) / 2.0)  # ITU-R P.526-15, eq. 30
    np.testing.assert_allclose(knife_edge_loss(nu), exact, atol=0.35)
    assert knife_edge_loss(np.array(-1.0)) == 0.0


def test_walls_hide_what_is_below_their_edge(canyon):
    """Middle of the street: the edge is 30 m above the antenna, 10 m away."""
    edge = np.degrees(np.arctan2(30.0, 10.0))
    sight = canyon([[0.0, 0.0, 0.0]], [90.0, 90.0, 270.0, 90.0], [edge - 5, edge + 5, 30.0, edge])
    loss = sight.loss[0]
    assert loss[0] > 12.0 and loss[1] < 1.0 and loss[2] > 25.0
    assert loss[3] == pytest.approx(6.0, abs=0.1)  # grazing


def test_along_the_street_the_sky_is_free(canyon):
    azimuth = np.arange(0.0, 360.0, 1.0)
    loss = canyon([[0.0, 0.0, 0.0]], azimuth, 25.0).loss[0]
    # blocked where tan(25°) < 3·|sin(azimuth)|, that is 8.9° off the street's axis
    off = np.degrees(np.arcsin(np.abs(np.sin(np.radians(azimuth)))))
    assert (loss[off < 6.0] < 6.0).all() and (loss[off > 12.0] > 6.0).all()


def test_near_the_crossing_street_its_gap_opens(canyon):
    """10 m before the northern end, a satellite to the north-east is seen past the corner."""
    north_east = canyon([[90.0, 0.0, 0.0], [0.0, 0.0, 0.0]], [40.0], [25.0]).loss[:, 0]
    assert north_east[0] < 1.0 and north_east[1] > 20.0


def test_tunnel_hides_everything(monkeypatch, canyon):
    monkeypatch.setitem(
        street_canyon.DENSITIES, "walls", dataclasses.replace(WALLS, tunnel_share=1.0)
    )
    positions = np.column_stack([np.arange(-100.0, 100.0), np.zeros((200, 2))])
    dark = np.isinf(canyon(positions, [0.0, 90.0], [80.0, 30.0]).loss)
    assert np.array_equal(dark[:, 0], dark[:, 1])
    assert 30 <= dark[:, 0].sum() <= 61
    assert not canyon(positions, [0.0], [80.0]).reflected[dark[:, 0]].any()


def test_reflections_come_from_the_lit_side_of_a_wall(canyon):
    rng = np.random.default_rng(0)
    azimuth, elevation = rng.uniform(0, 360, 200), rng.uniform(10, 60, 200)
    position = np.array([[3.0, 2.0, 1.0]])
    sight = canyon(position, azimuth, elevation)
    found = sight.reflected[0]
    assert found.sum() > 50
    az, el = np.radians(azimuth), np.radians(elevation)
    to_sat = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), -np.sin(el)], -1)
    normal, point = sight.wall_normal[0], sight.wall_point[0]
    np.testing.assert_allclose(np.linalg.norm(normal[found], axis=1), 1.0, atol=1e-12)
    depth = ((position - point) * normal).sum(1)
    assert (((to_sat * normal).sum(1))[found] > 0).all() and (depth[found] > 0).all()
    street = found & (np.abs(normal[:, 1]) > 0.99)
    # facades stand 10 m from the middle: 8 m to the east, 12 m to the west of the receiver
    east = normal[:, 1] < 0
    np.testing.assert_allclose(depth[street & east], 8.0, atol=1e-9)
    np.testing.assert_allclose(depth[street & ~east], 12.0, atol=1e-9)
    assert (found & ~street).any()


def test_probability_of_reflection_scales_their_number(canyon):
    rng = np.random.default_rng(0)
    azimuth, elevation = rng.uniform(0, 360, 2000), rng.uniform(10, 50, 2000)
    some, every = (
        canyon([[0.0, 0.0, 0.0]], azimuth, elevation, nlos=p).reflected.sum() for p in (0.3, 1.0)
    )
    assert some / every == pytest.approx(0.3, abs=0.05)
    assert canyon([[0.0, 0.0, 0.0]], azimuth, elevation, nlos=0.0).reflected.sum() == 0


def test_a_street_looks_the_same_on_the_second_visit():
    block = Block((3, 4, 0), 0.0, 200.0, 0.0, 200.0, np.array([-100.0, 0.0]))
    back = dataclasses.replace(block, start=900.0, end=1100.0, heading=np.pi)
    angles = np.full((1, 5), 1.0), np.full((1, 5), 0.6)
    looks = [
        City("urban", 9).sight(blocks, np.array([k]), np.zeros((1, 3)), *angles).loss
        for blocks, k in (((block,), 0), ((block, back), 1))
    ]
    assert np.array_equal(*looks)


def test_unknown_density_names_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'urban'"):
        City("urbn", 0)
