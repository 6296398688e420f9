"""RINEX and RTKLIB against a Kepler orbit, geometry and files written here, and real data."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets import gpstime
from certnav.datasets.rtklib import (
    ionosphere_delay,
    read_observations,
    satellite_states,
    single_point,
    troposphere_delay,
)
from certnav.datasets.rtklib.point_engine import PointEngine, spp_options
from certnav.datasets.rtklib.satellites import load_navigation
from certnav.filters.earth import EARTH_RATE, SPEED_OF_LIGHT, C_en_of, lla_to_ecef
from certnav.filters.errors import ConfigError, DataError
from certnav.velocity.least_squares import doppler_velocities
from certnav.velocity.range_rate import doppler_rows, line_of_sight, with_elevation

WEEK, SOW = 2129, 180600.0  # 2020-10-27 02:10:00
TIME = WEEK * 604800.0 + SOW
ANTENNA = lla_to_ecef(np.radians(30.53), np.radians(114.36), 35.0)
GPS_GM, BDS_GM, GPS_RATE, BDS_RATE = 3.986005e14, 3.986004418e14, 7.2921151467e-5, 7.292115e-5


class Orbit:
    """Eccentric Kepler orbit with a broadcast clock (IS-GPS-200, table 20-IV), toe = TIME."""

    def __init__(self, sat, node, anomaly, f0=2e-4, f1=-3e-12, health=0):
        self.sat, self.node, self.anomaly, self.f0, self.f1 = sat, node, anomaly, f0, f1
        self.bds = sat[0] == "C"
        self.sqrt_a, self.e = (5282.6 if self.bds else 5153.7), 0.012
        self.inclination, self.perigee, self.health = 0.96, 0.7, health
        self.gm, self.rate = (BDS_GM, BDS_RATE) if self.bds else (GPS_GM, GPS_RATE)
        self.toe_sow = SOW - (14.0 if self.bds else 0.0)

    def eccentric(self, dt):
        mean = self.anomaly + np.sqrt(self.gm) / self.sqrt_a**3 * dt
        E = mean
        for _ in range(30):
            E = mean + self.e * np.sin(E)
        return E

    def pos_e(self, dt):
        E = self.eccentric(dt)
        x = self.sqrt_a**2 * (np.cos(E) - self.e)
        y = self.sqrt_a**2 * np.sqrt(1 - self.e**2) * np.sin(E)
        cw, sw = np.cos(self.perigee), np.sin(self.perigee)
        x, y = cw * x - sw * y, sw * x + cw * y
        node = self.node - self.rate * dt - self.rate * self.toe_sow
        ci, si, cn, sn = (f(v) for v in (self.inclination, node) for f in (np.cos, np.sin))
        return np.array([x * cn - y * ci * sn, x * sn + y * ci * cn, y * si])

    def clock(self, dt):
        relativity = -2.0 * np.sqrt(self.gm) / SPEED_OF_LIGHT**2 * self.e * self.sqrt_a
        return self.f0 + self.f1 * dt + relativity * np.sin(self.eccentric(dt))

    def derivative(self, function, dt, h=20.0):
        p = [function(dt + k * h) for k in (-3, -2, -1, 1, 2, 3)]
        return (45.0 * (p[3] - p[2]) - 9.0 * (p[4] - p[1]) + p[5] - p[0]) / (60.0 * h)

    def rinex(self):
        calendar = gpstime.to_calendar(TIME - (14.0 if self.bds else 0.0))
        week = WEEK - 1356 if self.bds else WEEK
        first = f"{self.sat} {calendar:%Y %m %d %H %M %S}" + floats(self.f0, self.f1, 0.0)
        body = [
            (1.0, 0.0, 0.0, self.anomaly),
            (0.0, self.e, 0.0, self.sqrt_a),
            (self.toe_sow, 0.0, self.node, 0.0),
            (self.inclination, 0.0, self.perigee, 0.0),
            (0.0, 0.0, week, 0.0),
            (2.0, self.health, 0.0, 0.0 if self.bds else 1.0),
            (self.toe_sow, 0.0 if self.bds else 4.0),
        ]
        return [first, *("    " + floats(*row) for row in body)]


def floats(*values):
    return "".join(f"{v:19.12E}" for v in values)


def labelled(content, label):
    return f"{content:<60}{label:<20}"


@pytest.fixture(scope="module")
def orbits():
    """Nine GPS and three BeiDou satellites above 15° at TIME."""
    rng, up = np.random.default_rng(3), -C_en_of(ANTENNA)[:, 2]
    found: list[Orbit] = []
    while len(found) < 12:
        number = len(found)
        name = f"G{number + 1:02d}" if number < 9 else f"C{number + 11:02d}"
        orbit = Orbit(name, *rng.uniform(-np.pi, np.pi, 2), f0=rng.uniform(-4e-4, 4e-4))
        sight = orbit.pos_e(0.0) - ANTENNA
        if sight @ up > np.sin(np.radians(15.0)) * np.linalg.norm(sight):
            found.append(orbit)
    return found


@pytest.fixture(scope="module")
def navigation(orbits, tmp_path_factory):
    path = tmp_path_factory.mktemp("nav") / "brdc.20P"
    header = [
        labelled("     3.04           NAVIGATION DATA     M: MIXED", "RINEX VERSION / TYPE"),
        labelled("GPSA   1.0000E-08  0.0000E+00  0.0000E+00  0.0000E+00", "IONOSPHERIC CORR"),
        labelled("GPSB   9.0000E+04  0.0000E+00  0.0000E+00  0.0000E+00", "IONOSPHERIC CORR"),
        labelled("    18", "LEAP SECONDS"),
        labelled("", "END OF HEADER"),
    ]
    path.write_text("\n".join([*header, *(x for o in orbits for x in o.rinex()), ""]))
    return [path]


def travelled(orbit, pos_e, dt):
    """Return geometric range and transmission time (after TIME) for reception at `dt`."""
    flight = 0.075
    for _ in range(12):
        x, y, z = orbit.pos_e(dt - flight)
        c, s = np.cos(EARTH_RATE * flight), np.sin(EARTH_RATE * flight)
        flight = np.linalg.norm([c * x + s * y - pos_e[0], c * y - s * x - pos_e[1], z - pos_e[2]])
        flight /= SPEED_OF_LIGHT
    return SPEED_OF_LIGHT * flight, dt - flight


def exact_pseudorange(orbit, label=0.0, receiver_clock=1e-4):
    """Return the pseudorange [m] a receiver with that clock offset reads at its `label`."""
    distance, sent = travelled(orbit, ANTENNA, label - receiver_clock)
    return distance + SPEED_OF_LIGHT * (receiver_clock - orbit.clock(sent))


VERSION_3 = "     3.02           OBSERVATION DATA    M: MIXED"
END = labelled("", "END OF HEADER")


def rinex_302(orbits, epochs=2):
    """Return RINEX 3.02 as a Septentrio receiver writes it: 20 columns, no APPROX POSITION."""
    five = {"G": "1C 2W 2L 5Q 1P", "C": "1I 7I 6I 5X 2X"}
    lines = [labelled(VERSION_3, "RINEX VERSION / TYPE")]
    for system, signals in five.items():
        kinds = [kind + s for s in signals.split() for kind in "CLDS"]
        lines.append(labelled(f"{system}   20 " + " ".join(kinds[:13]), "SYS / # / OBS TYPES"))
        lines.append(labelled("       " + " ".join(kinds[13:]), "SYS / # / OBS TYPES"))
    lines.append(END)
    for k in range(epochs):
        lines.append(f"> 2020 10 27 02 10{k:11.7f}  0{len(orbits):3d}")
        for orbit in orbits:
            P = exact_pseudorange(orbit, float(k))
            one = f"{P:14.3f} 8{5.25 * P:14.3f}18{1234.567 + k:14.3f} 8{44.25:14.3f}  "
            other = f"{P + 3:14.3f}  {4.1 * P:14.3f}  {0.0:14.3f}  {31.0:14.3f}  "
            lines.append((orbit.sat + one + 4 * other).rstrip())
    return lines


def written(path, lines):
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def rover(orbits, tmp_path):
    return written(tmp_path / "campus-day.20O", rinex_302(orbits))


def test_rows_of_rinex_302_are_what_was_written(rover, orbits, navigation):
    assert max(map(len, rover.read_text().splitlines())) >= 321
    obs = read_observations(rover, navigation)
    assert len(obs) == 24 and obs.usable.all()
    np.testing.assert_array_equal(np.unique(obs.time), TIME + np.array([0.0, 1.0]))
    by_name = {o.sat: o for o in orbits}
    expected = [
        exact_pseudorange(by_name[s], t - TIME) for s, t in zip(obs.sat, obs.time, strict=True)
    ]
    np.testing.assert_allclose(obs.pseudorange, expected, atol=6e-4)
    np.testing.assert_allclose(obs.carrier, 5.25 * np.array(expected), atol=6e-4)
    gps = np.char.startswith(obs.sat, "G")
    assert set(obs.signal[gps]) == {"1C"} and set(obs.signal[~gps]) == {"2I"}
    frequency = np.where(gps, 1575.42e6, 1561.098e6)
    np.testing.assert_allclose(obs.wavelength, SPEED_OF_LIGHT / frequency, rtol=1e-12)
    doppler = 1234.567 + (obs.time - TIME)
    np.testing.assert_allclose(obs.range_rate, -obs.wavelength * doppler, atol=5e-5)
    np.testing.assert_allclose(obs.cn0, 44.25, atol=1e-3)
    assert set(obs.loss_of_lock) == {1}


def test_all_bands_share_the_satellite_state_and_zero_doppler_is_missing(rover, navigation):
    obs = read_observations(rover, navigation, signals="all", systems="G")
    assert len(obs) == 2 * 9 * 3
    first, second = (obs.signal == s for s in ("1C", "2W"))
    np.testing.assert_array_equal(obs.sat_pos_e[first], obs.sat_pos_e[second])
    assert np.isnan(obs.range_rate[second]).all() and not obs.has_range_rate[second].any()


def test_a_code_can_be_asked_for(rover, navigation):
    obs = read_observations(rover, navigation, systems="G", codes=["G1P"])
    assert set(obs.signal) == {"1P"}


def test_satellite_states_at_transmission_follow_kepler(rover, orbits, navigation):
    obs = read_observations(rover, navigation)
    by_name = {o.sat: o for o in orbits}
    for k in range(len(obs)):
        orbit = by_name[obs.sat[k]]
        # the receiver's clock is 0.1 ms fast: what it calls 0 s is −0.1 ms
        _, sent = travelled(orbit, ANTENNA, obs.time[k] - TIME - 1e-4)
        assert np.linalg.norm(obs.sat_pos_e[k] - orbit.pos_e(sent)) < 1e-4
        velocity = orbit.derivative(orbit.pos_e, sent)
        assert np.linalg.norm(obs.sat_vel_e[k] - velocity) < 1e-5
        assert obs.sat_clock[k] == pytest.approx(SPEED_OF_LIGHT * orbit.clock(sent), abs=1e-5)
        drift = SPEED_OF_LIGHT * orbit.derivative(orbit.clock, sent)
        assert obs.sat_clock_drift[k] == pytest.approx(drift, abs=1e-7)


def test_clock_drift_contains_the_relativistic_rate(orbits, navigation):
    """Without it the drift would be f1 for every satellite and time."""
    states = satellite_states(navigation, [o.sat for o in orbits], TIME)
    without = SPEED_OF_LIGHT * np.array([o.f1 for o in orbits])
    assert np.ptp(states.clock_drift - without) > 1e-3


def test_unknown_satellites_are_nan_and_unhealthy(navigation):
    states = satellite_states(navigation, ["G01", "G31"], [TIME, TIME])
    assert states.healthy.tolist() == [True, False]
    assert np.isfinite(states.pos_e[0]).all() and np.isnan(states.pos_e[1]).all()
    with pytest.raises(DataError, match="found 'X99'"):
        satellite_states(navigation, ["X99"], [TIME])


def test_rows_without_orbit_or_health_stay_and_say_why(orbits, tmp_path):
    sick = Orbit(orbits[0].sat, orbits[0].node, orbits[0].anomaly, orbits[0].f0, health=63)
    lines = [
        labelled("     3.04           NAVIGATION DATA     M: MIXED", "RINEX VERSION / TYPE"),
        END,
        *(x for o in [sick, *orbits[2:]] for x in o.rinex()),
    ]
    nav = [written(tmp_path / "sick.rnx", lines)]
    obs = read_observations(written(tmp_path / "a.rnx", rinex_302(orbits)), nav)
    assert set(obs.rejected[obs.sat == orbits[0].sat]) == {"unhealthy satellite"}
    assert set(obs.rejected[obs.sat == orbits[1].sat]) == {"no ephemeris"}
    assert obs.usable.sum() == 2 * 10


def test_single_point_recovers_the_antenna(rover, navigation):
    """Exact pseudoranges to 1 mm of print: the position must come back to that."""
    obs = read_observations(rover, navigation)
    spp = single_point(obs, navigation, ionosphere="off", troposphere="off")
    assert not spp.failed and set(spp.fixes.quality) == {"single"}
    np.testing.assert_array_equal(spp.fixes.time, TIME + np.array([0.0, 1.0]))
    np.testing.assert_allclose(spp.fixes.pos_e, np.tile(ANTENNA, (2, 1)), atol=5e-3)
    np.testing.assert_allclose(spp.clock, 1e-4 * SPEED_OF_LIGHT, atol=5e-3)
    assert not spp.fixes.has_velocity.any() and set(spp.fixes.satellites) == {12}


def test_single_point_uses_only_usable_rows(rover, navigation):
    obs = read_observations(rover, navigation)
    wrong = obs.with_columns(pseudorange=obs.pseudorange + np.where(obs.sat == "G03", 5000.0, 0.0))
    options = {"ionosphere": "off", "troposphere": "off", "raim": False}
    marked = single_point(wrong.mark(obs.sat == "G03", "test"), navigation, **options)
    assert np.abs(marked.fixes.pos_e - ANTENNA).max() < 5e-3
    assert marked.rejected == () and "G03" not in marked.satellites[0]
    trusting = single_point(wrong, navigation, **options)
    assert np.abs(trusting.fixes.pos_e - ANTENNA).max() > 100.0


@pytest.mark.parametrize("fault", [120.0, 5000.0, -300.0])
def test_faulty_pseudoranges_are_excluded_and_named(rover, navigation, fault):
    obs = read_observations(rover, navigation)
    faulty = np.isin(obs.sat, ["G03", "G07"])
    wrong = obs.with_columns(pseudorange=obs.pseudorange + np.where(faulty, fault, 0.0))
    spp = single_point(wrong, navigation, ionosphere="off", troposphere="off")
    assert spp.rejected == tuple(np.flatnonzero(faulty))
    assert np.abs(spp.fixes.pos_e - ANTENNA).max() < 5e-3
    assert set(spp.fixes.satellites) == {10}


def test_faults_that_cannot_be_told_apart_fail_the_epoch(rover, navigation):
    obs = read_observations(rover, navigation)
    five = obs.mark(~np.isin(obs.sat, ["G01", "G02", "G03", "G04", "G05"]), "test")
    wrong = five.with_columns(
        pseudorange=five.pseudorange + np.where(obs.sat == "G02", 3000.0, 0.0)
    )
    spp = single_point(wrong, navigation, ionosphere="off", troposphere="off")
    assert len(spp.fixes) == 0
    assert all(reason == "inconsistent pseudoranges" for _, reason in spp.failed)


def test_single_point_names_the_epochs_without_solution(rover, navigation):
    obs = read_observations(rover, navigation)
    few = obs.mark((obs.time > TIME) & ~np.isin(obs.sat, ["G01", "G02"]), "test")
    spp = single_point(few, navigation, ionosphere="off", troposphere="off")
    assert len(spp.fixes) == 1 and spp.failed == ((TIME + 1.0, "2 satellites"),)
    none = single_point(obs.mark(obs.cn0 > 0, "test"), navigation)
    assert len(none.fixes) == 0 and len(none.failed) == 2


@pytest.mark.parametrize("code_sigma", [0.9, 30.0])
def test_single_point_covariance_is_the_documented_one(rover, navigation, code_sigma):
    """(HᵀWH)⁻¹ with H from the geometry here and the σ the docstring lists; URA 2.4 m."""
    obs = read_observations(rover, navigation, systems="G")
    first = with_elevation(obs.take(obs.time == TIME), ANTENNA)
    spp = single_point(
        first, navigation, ionosphere="off", troposphere="off", code_sigma=code_sigma
    )
    variance = code_sigma**2 * (1.0 + 1.0 / np.sin(first.elevation))
    variance += 2.4**2 + 5.0**2 + 3.0**2 + 0.3**2
    e_e = line_of_sight(ANTENNA, first.sat_pos_e, first.sat_vel_e).e_e
    H = np.column_stack([-e_e, np.ones(len(first))])
    expected = np.linalg.inv(H.T @ (H / variance[:, None]))[:3, :3]
    np.testing.assert_allclose(spp.fixes.pos_cov_e[0], expected, rtol=1e-4, atol=1e-3)


def test_residuals_inflate_the_covariance(rover, navigation):
    obs = read_observations(rover, navigation, systems="G")
    rng = np.random.default_rng(5)
    noisy = obs.with_columns(pseudorange=obs.pseudorange + 30.0 * rng.standard_normal(len(obs)))
    exact, rough = (
        single_point(o, navigation, ionosphere="off", troposphere="off", significance=1e-99)
        for o in (obs, noisy)
    )
    ratio = rough.fixes.pos_cov_e[:, 0, 0] / exact.fixes.pos_cov_e[:, 0, 0]
    assert (ratio > 5.0).all()
    # That of all of them together lies between those of each.
    assert ratio.min() < rough.misfit < ratio.max() and exact.misfit < 1e-3


def test_atmosphere_has_the_size_and_shape_of_its_models(navigation):
    elevation = np.radians([90.0, 30.0, 10.0])
    delay = troposphere_delay(TIME, ANTENNA, elevation)
    assert delay[0] == pytest.approx(2.4, abs=0.15)
    np.testing.assert_allclose(delay[1] / delay[0], 2.0, rtol=0.02)
    # α0 10 ns, β0 90 000 s: Klobuchar at night is 5 ns times the obliquity, by day up to 15 ns
    night = TIME - (TIME % 86400.0) + 16.0 * 3600.0  # 23:37 local
    day = TIME - (TIME % 86400.0) + 6.4 * 3600.0  # 14:00 local
    zenith = ionosphere_delay(navigation, [night, day], ANTENNA, 0.0, np.pi / 2)
    obliquity = 1.0 + 16.0 * (0.53 - 0.5) ** 3
    assert zenith[0] == pytest.approx(5e-9 * SPEED_OF_LIGHT * obliquity, rel=1e-4)
    assert zenith[1] == pytest.approx(15e-9 * SPEED_OF_LIGHT * obliquity, rel=1e-2)


def rinex_211(orbits):
    lines = [
        labelled("     2.11           OBSERVATION DATA    G (GPS)", "RINEX VERSION / TYPE"),
        labelled("     1     1", "WAVELENGTH FACT L1/2"),
        labelled("     4    C1    L1    D1    S1", "# / TYPES OF OBSERV"),
        END,
    ]
    gps = [o for o in orbits if o.sat[0] == "G"]
    for k in range(2):
        names = "".join(o.sat for o in gps)
        lines.append(f" 20 10 27  2 10 {k:10.7f}  0{len(gps):3d}{names}")
        for orbit in gps:
            P = exact_pseudorange(orbit, float(k))
            lines.append(f"{P:14.3f}  {5.25 * P:14.3f}  {-321.125:14.3f}  {41.5:14.3f}")
    return lines


def test_rinex_211(orbits, navigation, tmp_path):
    obs = read_observations(written(tmp_path / "a.20o", rinex_211(orbits)), navigation)
    assert len(obs) == 18 and set(obs.signal) == {"1C"} and obs.usable.all()
    np.testing.assert_allclose(obs.range_rate, 321.125 * obs.wavelength, atol=5e-5)
    by_name = {o.sat: o for o in orbits}
    expected = [
        exact_pseudorange(by_name[s], t - TIME) for s, t in zip(obs.sat, obs.time, strict=True)
    ]
    np.testing.assert_allclose(obs.pseudorange, expected, atol=6e-4)


def refusal(call, *args):
    with pytest.raises(DataError) as caught:
        call(*args)
    message = str(caught.value)
    assert "\n" not in message and "Traceback" not in message
    return caught.value


def test_wrong_week_is_refused(orbits, navigation, tmp_path):
    lines = [x.replace("> 2020 10 27", "> 2022 10 23") for x in rinex_302(orbits)]
    error = refusal(read_observations, written(tmp_path / "late.22O", lines), navigation)
    assert "observations 2022-10-23" in str(error) and "ephemerides 2020-10-27" in str(error)
    assert error.remedy == "wrong week or wrong navigation file"


def test_missing_files_are_refused(rover, navigation, tmp_path):
    assert "not found" in str(refusal(read_observations, tmp_path / "no.20O", navigation))
    assert "not found" in str(refusal(read_observations, rover, [tmp_path / "no.rnx"]))
    assert "no navigation file" in str(refusal(read_observations, rover, []))


def test_unknown_options_are_refused(rover, navigation):
    with pytest.raises(ConfigError, match="'first' or 'all'"):
        read_observations(rover, navigation, signals="L1")
    with pytest.raises(ConfigError, match="G GPS"):
        read_observations(rover, navigation, systems="GX")
    obs = read_observations(rover, navigation)
    with pytest.raises(ConfigError, match="broadcast, off"):
        single_point(obs, navigation, ionosphere="klobuchar")
    with pytest.raises(ConfigError, match="elevation_mask"):
        single_point(obs, navigation, elevation_mask=15.0)


def test_live_sky_static_receiver(data_dir):
    """u-blox F9P, four constellations, static: per-satellite Doppler residuals are unbiased."""
    folder = data_dir / "instinct" / "tckf_static"
    nav = [folder / "reach-m2-01_raw_202306291111.nav"]
    obs = read_observations(folder / "reach-m2-01_raw_202306291111.23O", nav)
    assert {"1C", "1X", "2I"} == set(obs.signal)
    spp = single_point(obs, nav, elevation_mask=np.radians(10.0), min_cn0=30.0)
    assert len(spp.fixes) == 610 and not spp.failed
    centre = spp.fixes.pos_e.mean(0)
    sigma = np.sqrt(np.trace(spp.fixes.pos_cov_e, axis1=1, axis2=2)).mean()
    assert np.linalg.norm(spp.fixes.pos_e.std(0)) < 0.4 < sigma

    strong = obs.mark(obs.cn0 < 30.0, "weak")
    velocity = np.array([v.vel_e for v in doppler_velocities(strong, centre)])
    rms_n = np.sqrt(np.mean((velocity @ C_en_of(centre)) ** 2, axis=0))
    assert (rms_n < [0.02, 0.02, 0.04]).all()

    rows = doppler_rows(strong, centre)
    drift = np.zeros(len(rows))
    time = strong.time[rows.row]
    for t in np.unique(time):
        drift[time == t] = np.median(rows.z[time == t])
    for system in "GREC":
        of_system = np.char.startswith(rows.sat, system)
        assert abs(np.median((rows.z - drift)[of_system])) < 0.003


@pytest.mark.parametrize("systems", ["G", "R", "E", "C", "GREC"])
def test_fault_test_weighs_as_pntpos_does(data_dir, systems):
    """RTKLIB keeps its σ to itself: the ones rebuilt here must give its covariance."""
    folder = data_dir / "instinct" / "tckf_static"
    nav = [folder / "reach-m2-01_raw_202306291111.nav"]
    obs = read_observations(folder / "reach-m2-01_raw_202306291111.23O", nav, systems=systems)
    options = spp_options(np.radians(10.0), "broadcast", "saastamoinen", 0.9)
    engine = PointEngine(load_navigation(nav), options, obs)
    _, rows = next(obs.epochs())
    point = engine.solve(np.flatnonzero(obs.usable[rows]))
    covariance = np.linalg.inv(point.H.T @ (point.H / point.sigma[:, None] ** 2))[:3, :3]
    np.testing.assert_allclose(covariance, point.cov_e, rtol=1e-5)


def test_weak_signals_are_weighted_down_by_one_more_least_squares_step(data_dir):
    folder = data_dir / "instinct" / "tckf_static"
    nav = [folder / "reach-m2-01_raw_202306291111.nav"]
    obs = read_observations(folder / "reach-m2-01_raw_202306291111.23O", nav, systems="GE")
    options = spp_options(np.radians(10.0), "broadcast", "saastamoinen", 1.0)
    _, rows = next(obs.epochs())
    use = np.flatnonzero(obs.usable[rows])
    plain = PointEngine(load_navigation(nav), options, obs).solve(use)
    weighted = PointEngine(load_navigation(nav), options, obs, 2.5).solve(use)
    added = np.sqrt(weighted.sigma**2 - plain.sigma**2)
    expected = 2.5 * 10.0 ** (np.maximum(45.0 - obs.cn0[weighted.used], 0.0) / 20.0)
    np.testing.assert_allclose(added, expected)
    # The normal equations hold, and the covariance is that of these weights.
    whitened = weighted.H / weighted.sigma[:, None]
    gradient = whitened.T @ (weighted.residuals / weighted.sigma)
    before = whitened.T @ (plain.residuals / weighted.sigma)
    assert np.abs(gradient).max() < 1e-6 * np.abs(before).max()
    np.testing.assert_allclose(
        weighted.cov_e, np.linalg.inv(whitened.T @ whitened)[:3, :3], rtol=1e-6
    )
    step = weighted.pos_e - plain.pos_e
    np.testing.assert_allclose(
        plain.residuals - weighted.residuals, plain.H[:, :3] @ step
        + plain.H[:, 3:] @ np.linalg.lstsq(
            plain.H[:, 3:], plain.residuals - weighted.residuals - plain.H[:, :3] @ step, rcond=None
        )[0], atol=1e-6,
    )  # fmt: skip
