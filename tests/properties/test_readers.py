"""What is written reads back, whatever it holds; what a file means does not hang on its form."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from certnav.datasets.axes import axes_matrix
from certnav.datasets.formats.inertial_explorer import read_reference_table
from certnav.datasets.formats.kfgins import read_nav
from certnav.datasets.formats.rtklib_pos import read_pos
from certnav.datasets.great.writer import write_imu, write_reference
from certnav.datasets.own.declaration import ACCEL_UNITS, GYRO_UNITS
from certnav.datasets.own.reader import read_declared
from certnav.datasets.series import ImuData, Reference
from certnav.datasets.text.columns import open_text, read_columns
from certnav.datasets.text.imu import read_imu_table, read_imu_text
from certnav.datasets.text.tables import read_table
from certnav.filters.earth import C_en_at, C_en_of, ecef_to_lla, lla_to_ecef
from certnav.filters.rotation import matrix_from_rpy, rpy_from_matrix
from certnav.nav.config import AlignmentConfig, Config, FilterConfig, GnssConfig, VehicleConfig
from certnav.nav.config_files import load_config, to_toml
from certnav.nav.results.formats import write_nav, write_pos, write_tum
from certnav.nav.results.tables import read_solution, write_solution
from certnav.nav.solution import Epochs, Trajectory
from oracles.bends import bends
from oracles.declarations import PLAIN, changed

seeds = st.integers(0, 2**32 - 1)
WEEK = 2129


# --- numbers ---------------------------------------------------------------------------------

numbers = st.one_of(
    st.floats(-1e20, 1e20).map(repr),
    st.integers(-(10**19), 10**19).map(str),
    st.from_regex(
        r"[+-]?(\d{1,25}\.\d{0,25}|\.\d{1,25}|\d{1,25})([eE][+-]?\d{1,2})?", fullmatch=True
    ),
).filter(lambda text: text.isascii() and abs(float(text)) < 1e20)


@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=20), st.booleans())
@example([("9007199254740993", "0.1", "1e19")], True)
@example([("123456789012345678", "5e-324", "2.2250738585072011e-308")], False)
def test_numbers_are_those_python_reads(tmp_path_factory, rows, crlf):
    """To the last bit: the compiled parser, pandas and `float` may not differ."""
    file = tmp_path_factory.mktemp("numbers") / "a.txt"
    end = "\r\n" if crlf else "\n"
    file.write_text(end.join(" ".join(row) for row in rows) + end, newline="")
    found = read_table(file, ("a", "b", "c"))
    np.testing.assert_array_equal(found.values, [[float(t) for t in row] for row in rows])
    np.testing.assert_array_equal(found.line, np.arange(1, len(rows) + 1))


@given(st.sampled_from([",", ";", "\t", " "]), st.permutations("abcd"), st.booleans(), seeds)
def test_columns_are_found_by_name_in_any_order(tmp_path_factory, separator, order, packed, seed):
    import gzip

    value = np.random.default_rng(seed).normal(size=(5, 4)).round(6)
    text = separator.join(order) + "\n"
    text += "".join(separator.join(map(repr, map(float, row))) + "\n" for row in value)
    file = tmp_path_factory.mktemp("columns") / "a.csv"
    file.write_bytes(gzip.compress(text.encode()) if packed else text.encode())
    found = read_columns(open_text(file), {"one": ["a", "c"], "two": [1]})
    expected = value[:, [order.index("a"), order.index("c")]]
    np.testing.assert_array_equal(found.numbers["one"], expected)
    np.testing.assert_array_equal(found.numbers["two"], value[:, :1])


# --- configuration ---------------------------------------------------------------------------

positive = st.floats(1e-6, 1e6)
optional_angle = st.one_of(st.none(), st.floats(-180.0, 180.0))
words = st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), max_size=12)
configs = st.builds(
    Config,
    st.builds(
        AlignmentConfig,
        method=st.sampled_from(["auto", "level+course"]),
        min_speed_mps=positive,
        roll_deg=optional_angle,
        pitch_deg=optional_angle,
        heading_deg=optional_angle,
        sigma_heading_deg=positive,
    ),
    st.builds(
        FilterConfig,
        states=st.sampled_from([15, 21]),
        bias_model=st.sampled_from(["random-walk", "gauss-markov"]),
        imu=st.sampled_from(["", "adis16470", "tactical"]),
        gate_probability=st.floats(0.0, 0.999),
        smooth=st.booleans(),
        output_rate_hz=st.floats(0.0, 1e3),
    ),
    st.builds(
        GnssConfig,
        position=st.sampled_from(["auto", "spp", "rtk", "carried", "none"]),
        base=words,
        base_position_e_m=st.one_of(
            st.just(()), st.tuples(*3 * [st.floats(-7e6, 7e6)])
        ),
        raim=st.booleans(),
        elevation_mask_deg=st.floats(-90.0, 89.9),
        code_sigma_m=positive,
    ),
    st.builds(VehicleConfig, nhc=st.sampled_from(["auto", "on", "off"]), interval_s=positive),
    st.dictionaries(
        st.sampled_from(["lever", "week", "imu", "reference_point", "systems"]),
        st.one_of(words, st.integers(-(10**9), 10**9), st.booleans(), st.lists(positive)),
    ),
)  # fmt: skip


@given(configs)
def test_configuration_through_toml(tmp_path_factory, config):
    file = tmp_path_factory.mktemp("config") / "c.toml"
    file.write_text(to_toml(config), encoding="utf-8")
    assert load_config(file) == config


@given(configs)
def test_configuration_through_assignments(config):
    """``--set`` understands every value as TOML prints it."""
    lines, section = [], ""
    for line in to_toml(config).splitlines():
        if line.startswith("["):
            section = line.strip("[]")
        elif line and not line.startswith("#"):
            lines.append(f"{section}.{line}")
    assert load_config(None, lines) == config


# --- solutions -------------------------------------------------------------------------------


@st.composite
def trajectories(draw):
    """A few epochs anywhere on Earth, any attitude, any covariance."""
    rng = np.random.default_rng(draw(seeds))
    n = draw(st.integers(2, 8))
    lat, lon = draw(st.floats(-1.5, 1.5)), draw(st.floats(-3.1, 3.1))
    start = WEEK * 604800.0 + draw(st.sampled_from([0.0, 3600.5, 604799.0]))
    pos_e = lla_to_ecef(lat, lon, rng.uniform(-100, 4000)) + np.cumsum(rng.normal(size=(n, 3)), 0)

    def covariance(sigma):
        A = rng.normal(size=(n, 3, 3)) * sigma
        return A @ np.swapaxes(A, 1, 2) + sigma**2 * np.eye(3)

    return Trajectory(
        time=start + np.arange(n) / 8.0,
        pos_e=pos_e,
        vel_e=rng.uniform(-40.0, 40.0, (n, 3)),
        C_eb=C_en_of(pos_e) @ matrix_from_rpy(rng.uniform([-3, -1.5, -3], [3, 1.5, 3], (n, 3))),
        gyro_bias=rng.normal(0.0, 1e-3, (n, 3)),
        accel_bias=rng.normal(0.0, 0.1, (n, 3)),
        cov_pos_n=covariance(1.0),
        cov_vel_n=covariance(0.1),
        cov_att_n=covariance(0.01),
        std_gyro_bias=rng.uniform(1e-5, 1e-3, (n, 3)),
        std_accel_bias=rng.uniform(1e-3, 0.1, (n, 3)),
    )


NO_EPOCHS = Epochs(np.empty(0), np.empty(0, int), np.empty(0, int))


@given(trajectories())
def test_solution_csv(tmp_path_factory, t):
    file = tmp_path_factory.mktemp("solution") / "solution.csv"
    write_solution(file, t)
    again = read_solution(file)
    np.testing.assert_allclose(again.time, t.time, atol=1e-6)
    np.testing.assert_allclose(again.pos_e, t.pos_e, atol=6e-5)
    np.testing.assert_allclose(again.vel_e, t.vel_e, atol=2e-5)
    np.testing.assert_allclose(again.C_eb, t.C_eb, atol=5e-8)
    np.testing.assert_allclose(again.gyro_bias, t.gyro_bias, atol=5e-10)
    np.testing.assert_allclose(again.accel_bias, t.accel_bias, atol=1e-7)
    for name in ("cov_pos_n", "cov_vel_n"):
        of, found = (np.diagonal(getattr(x, name), axis1=1, axis2=2) for x in (t, again))
        np.testing.assert_allclose(found, of, rtol=2e-4)
    np.testing.assert_allclose(again.std_accel_bias, t.std_accel_bias, rtol=1e-4)


@given(trajectories())
def test_rtklib_pos(tmp_path_factory, t):
    """Full covariances too: RTKLIB's signed roots, east before down."""
    file = tmp_path_factory.mktemp("pos") / "a.pos"
    write_pos(file, t, NO_EPOCHS)
    fixes = read_pos(file)
    np.testing.assert_allclose(fixes.time, t.time, atol=1e-6)
    np.testing.assert_allclose(fixes.pos_e, t.pos_e, atol=2e-4)
    np.testing.assert_allclose(fixes.vel_e, t.vel_e, atol=2e-5)
    C_en = C_en_of(t.pos_e)
    for found, cov_n in ((fixes.pos_cov_e, t.cov_pos_n), (fixes.vel_cov_e, t.cov_vel_n)):
        expected = C_en @ cov_n @ np.swapaxes(C_en, 1, 2)
        size = np.trace(expected, axis1=1, axis2=2)[:, None, None]
        np.testing.assert_allclose(found / size, expected / size, atol=2e-3)


@given(trajectories())
def test_kf_gins_nav(tmp_path_factory, t):
    file = tmp_path_factory.mktemp("nav") / "a.nav"
    write_nav(file, t, NO_EPOCHS)
    nav = read_nav(file)
    np.testing.assert_allclose(nav.time, t.time, atol=1e-6)
    np.testing.assert_allclose(nav.pos_e, t.pos_e, atol=2e-4)
    np.testing.assert_allclose(nav.vel_e, t.vel_e, atol=2e-5)
    np.testing.assert_allclose(C_en_of(t.pos_e) @ matrix_from_rpy(nav.rpy), t.C_eb, atol=1e-8)


@given(trajectories())
def test_tum(tmp_path_factory, t):
    """Position and attitude are relative to axes that the comment line says how to place."""
    file = tmp_path_factory.mktemp("tum") / "a.tum"
    write_tum(file, t, NO_EPOCHS)
    tokens = file.read_text().splitlines()[0].replace(",", " ").split()
    lat, lon, height = (float(tokens[tokens.index(k) + 1]) for k in ("lat", "lon", "height"))
    table = np.loadtxt(file)
    C_e_enu = C_en_at(np.radians(lat), np.radians(lon))[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    origin = lla_to_ecef(np.radians(lat), np.radians(lon), height)
    np.testing.assert_allclose(table[:, 0], t.time, atol=1e-6)
    np.testing.assert_allclose(origin + table[:, 1:4] @ C_e_enu.T, t.pos_e, atol=3e-4)
    C = C_e_enu @ Rotation.from_quat(table[:, 4:8]).as_matrix()
    np.testing.assert_allclose(C, t.C_eb, atol=1e-8)


# --- GREAT -----------------------------------------------------------------------------------


@given(seeds, st.sampled_from([0.0, 3600.0, 604799.9]), st.integers(2, 30))
def test_great_imu_text(tmp_path_factory, seed, sow, n):
    """Over the end of the week too: the file's seconds of week start again, time does not."""
    rng = np.random.default_rng(seed)
    time = WEEK * 604800.0 + sow + np.arange(n) / 100.0
    imu = ImuData(time, rng.normal(size=(n, 3)), rng.normal(0.0, 10.0, (n, 3)))
    file = tmp_path_factory.mktemp("imu") / "a.txt"
    write_imu(file, imu)
    again = read_imu_text(file, week=WEEK, gyro_unit="deg/s")
    np.testing.assert_allclose(again.time, time, atol=5.1e-6)
    np.testing.assert_allclose(again.gyro_b, imu.gyro_b, atol=1e-12)
    np.testing.assert_allclose(again.accel_b, imu.accel_b, atol=6e-11)
    assert np.diff(read_imu_table(file).sow).min() > 0.0


@given(trajectories(), st.floats(-0.2, 0.2))
def test_great_reference(tmp_path_factory, t, tilt):
    C_bv = matrix_from_rpy([tilt, -tilt, 2.0 * tilt]).T
    n = len(t)
    # the reader holds velocities against differenced positions
    vel_e = np.tile(np.array([3.0, -2.0, 1.0]), (n, 1))
    pos_e = t.pos_e[0] + vel_e * (t.time - t.time[0])[:, None]
    C_nb = np.swapaxes(C_en_of(pos_e), 1, 2) @ t.C_eb
    reference = Reference(t.time, pos_e, vel_e, rpy_from_matrix(C_nb), np.zeros(3), "imu", "drawn")
    file = tmp_path_factory.mktemp("reference") / "a.txt"
    write_reference(file, reference, C_bv)
    again = read_reference_table(file)
    np.testing.assert_allclose(again.time, t.time, atol=5.1e-4)
    np.testing.assert_allclose(again.pos_e, pos_e, atol=6e-5)
    np.testing.assert_allclose(again.vel_e, vel_e, atol=6e-6)
    np.testing.assert_allclose(matrix_from_rpy(again.rpy), C_nb @ C_bv, atol=1e-8)


# --- own data --------------------------------------------------------------------------------

START, HZ, SPAN = WEEK * 604800.0 + 180000.0, 25.0, 40.0
#: Time scale: what stands in the column(s), and the lines that declare it.
SCALES = {
    "gps": (lambda t: t, 'scale = "gps"\nunit = "s"'),
    "gps ms": (lambda t: t * 1e3, 'scale = "gps"\nunit = "ms"'),
    "gps-sow": (lambda t: t - WEEK * 604800.0, f'scale = "gps-sow"\nweek = {WEEK}'),
    "unix": (lambda t: t + 315964800.0 - 18.0, 'scale = "unix"'),
    "offset": (lambda t: t - START + 5.0, f'scale = "gps"\noffset_s = {START - 5.0}'),
}
AXES = [a + b + c for a in "FBRLDU" for b in "FBRLDU" for c in "FBRLDU"]


def is_right_handed(name):
    try:
        axes_matrix(name, key="axes")
    except Exception:
        return False
    return True


AXES = [name for name in AXES if is_right_handed(name)]


@settings(max_examples=40)
@given(
    st.sampled_from(sorted(SCALES)),
    st.sampled_from(AXES),
    st.sampled_from(sorted(GYRO_UNITS)),
    st.sampled_from(sorted(ACCEL_UNITS)),
    st.sampled_from([",", ";", "\t", " "]),
    st.permutations(["t", "gx", "gy", "gz", "ax", "ay", "az"]),
    st.booleans(),
)
def test_a_declaration_undoes_what_it_declares(
    tmp_path_factory, scale, axes, gyro_unit, accel_unit, separator, order, by_number
):
    """Any units, axes, time scale and order of columns: the same motion comes out."""
    folder = tmp_path_factory.mktemp("own")
    drive = bends(START, HZ, SPAN)
    t, vel_n, pos_e = drive.time, drive.vel_n, drive.pos_e
    gyro = drive.gyro_b + np.array([0.01, 0.02, 0.0])
    accel = drive.accel_b + np.array([0.1, 0.0, 0.0])
    stamp, lines = SCALES[scale]
    C_bs = axes_matrix(axes, key="axes")
    columns = {"t": stamp(t)}
    for sensor, value, (factor, increments) in (
        ("g", gyro, GYRO_UNITS[gyro_unit]),
        ("a", accel, ACCEL_UNITS[accel_unit]),
    ):
        value = value @ C_bs / factor * (1.0 / HZ if increments else 1.0)
        columns |= {f"{sensor}{axis}": value[:, k] for k, axis in enumerate("xyz")}
    table = np.column_stack([columns[name] for name in order])
    np.savetxt(folder / "imu.csv", table, "%.12g", separator, header=separator.join(order),
               comments="")  # fmt: skip
    k = slice(None, None, int(HZ))
    lla = ecef_to_lla(pos_e[k]) * [180.0 / np.pi, 180.0 / np.pi, 1.0]
    table = np.column_stack([stamp(t[k]), lla, vel_n[k]])
    np.savetxt(folder / "gnss.csv", table, "%.12g", ",", header="t,lat,lon,h,vn,ve,vd", comments="")

    def column(name):
        return str(order.index(name) + 1) if by_number else f'"{name}"'

    gyro_columns, accel_columns = (
        "[" + ", ".join(column(s + a) for a in "xyz") + "]" for s in "ga"
    )
    whole = changed(
        PLAIN,
        ('scale = "gps-sow"\nweek = 2129', lines),
        ('file = "imu.csv"\ntime = "t"', f'file = "imu.csv"\ntime = {column("t")}'),
        ('["gx", "gy", "gz"]', gyro_columns),
        ('["ax", "ay", "az"]', accel_columns),
        ('"deg/s"', f'"{gyro_unit}"'),
        ('"m/s2"', f'"{accel_unit}"'),
        ('"RFU"', f'"{axes}"'),
        ('position_sigma = ["sn", "se", "su"]', "position_sigma_m = [1.0, 1.0, 2.0]"),
    )
    (folder / "sequence.toml").write_text(whole.partition("[reference]")[0])
    sequence = read_declared(folder)
    np.testing.assert_allclose(sequence.imu.time, t, atol=2e-3)  # 12 digits of 1.3e12 ms
    # the first increment's interval is unknown and taken as the usual one, as they all are here
    tolerance = 2e-2 if GYRO_UNITS[gyro_unit][1] or ACCEL_UNITS[accel_unit][1] else 1e-9
    np.testing.assert_allclose(sequence.imu.gyro_b, gyro, atol=tolerance)
    np.testing.assert_allclose(sequence.imu.accel_b, accel, atol=max(tolerance, 1e-9) * 10)
    np.testing.assert_allclose(sequence.fixes.pos_e, pos_e[k], atol=1e-3)
    vel_e = np.einsum("nij,nj->ni", C_en_of(pos_e[k]), vel_n[k])
    np.testing.assert_allclose(sequence.fixes.vel_e, vel_e, atol=1e-6)
    verified = [note for note in sequence.notes if "verified" in note]
    assert len(verified) == 2  # gravity and the course have confirmed what was declared


def test_every_configuration_field_is_drawn_or_printed():
    """A field that TOML cannot hold would be lost from config.toml of every run."""
    text = to_toml(Config())
    for section in dataclasses.fields(Config):
        part = getattr(Config(), section.name)
        for field in dataclasses.fields(part) if section.name != "data" else ():
            assert f"{field.name} " in text, f"{section.name}.{field.name}"
    with pytest.raises(Exception, match="unknown key"):
        load_config(None, ["filter.nothing=1"])
