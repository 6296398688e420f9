"""A trajectory in the words of other programs, written from their documents."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from certnav.datasets.gpstime import to_week_sow
from certnav.datasets.series import Reference
from certnav.filters.earth import C_en_of, ecef_to_lla

#: 1σ that are stated: of ECEF axes of position and velocity, of pitch, roll and yaw [deg].
SIGMA_POS, SIGMA_VEL, SIGMA_ATT = (0.4, 0.5, 0.6), (0.05, 0.06, 0.07), (0.1, 0.2, 1.5)


def _common(r: Reference):
    week, sow = to_week_sow(r.time)
    vel_n = np.einsum("nji,nj->ni", C_en_of(r.pos_e), r.vel_e)
    lla = ecef_to_lla(r.pos_e) * [180.0 / np.pi, 180.0 / np.pi, 1.0]
    return week, sow, lla, vel_n, np.degrees(r.rpy)


def write_ginav(path: Path, r: Reference) -> None:
    """Write a coupled solution of GINav: RTKLIB's columns in ECEF, then attitude and its σ."""
    week, sow, _, _, rpy = _common(r)
    lines = [
        "% program   : GINav v0.1.0",
        "%  GPST x-ecef(m) y-ecef(m) z-ecef(m) Q ns sdx(m) sdy(m) sdz(m) sdxy(m) sdyz(m) sdzx(m) "
        "age(s) ratio vx(m/s) vy(m/s) vz(m/s) sdvx sdvy sdvz sdvxy sdvyz sdvzx pitch(deg) "
        "roll(deg) yaw(deg) sdp sdr sdy sdpr sdry sdyp",
    ]
    for k in range(r.time.size):
        roll, pitch, yaw = rpy[k]
        row = [*r.pos_e[k], 1, 9, *SIGMA_POS, 0, 0, 0, 0, 0, *r.vel_e[k], *SIGMA_VEL, 0, 0, 0]
        row += [pitch, roll, yaw % 360.0, *SIGMA_ATT, 0, 0, 0]
        lines.append(f"{week[k]:d} {sow[k]:.3f} " + " ".join(f"{v:.6f}" for v in row))
    text = "\n".join(lines).replace(" 1.000000 9.000000 ", " 1 9 ")
    path.write_text(text + "\n")


def write_great_ins(path: Path, r: Reference) -> None:
    """Write a GREAT-MSF result: yaw from north to west."""
    _, sow, _, _, rpy = _common(r)
    head = "# SOW X Y Z VX VY VZ Pitch Roll Yaw GyroBias AcceBias MeasType Nsat PDOP AmbStatus"
    lines = [head, "# (s) (m) (m) (m) (m/s) (m/s) (m/s) (deg) (deg) (deg) (deg/h) (mg)"]
    for k in range(r.time.size):
        roll, pitch, heading = rpy[k]
        row = [sow[k], *r.pos_e[k], *r.vel_e[k], pitch, roll, -heading, 1, 2, 3, 0.1, 0.2, 0.3]
        lines.append(" ".join(f"{v:.6f}" for v in row) + " GNSS 12 1.3 Fixed 9.9")
    path.write_text("\n".join(lines) + "\n")


def write_tum(path: Path, r: Reference) -> None:
    """Write a TUM trajectory in ECEF axes."""
    _, _, _, _, _ = _common(r)
    C_en = C_en_of(r.pos_e)
    C_nb = Rotation.from_euler("ZYX", r.rpy[:, ::-1]).as_matrix()
    q = Rotation.from_matrix(C_en @ C_nb).as_quat()
    table = np.column_stack([r.time, r.pos_e, q])
    np.savetxt(path, table, "%.4f" + " %.5f" * 3 + " %.9f" * 4)


def write_nav(path: Path, r: Reference) -> None:
    """Write a KF-GINS result."""
    week, sow, lla, vel_n, rpy = _common(r)
    np.savetxt(path, np.column_stack([week, sow, lla, vel_n, rpy]), "%d %.6f" + " %.10f" * 9)


def write_csv(path: Path, r: Reference) -> None:
    """Write named columns, some of them nobody's."""
    _, _, lla, vel_n, rpy = _common(r)
    n = r.time.size
    table = np.column_stack([r.time, lla, vel_n, rpy, np.tile([0.4, 0.5, 0.6], (n, 1)), np.ones(n)])
    head = (
        "time_gps_s,lat_deg,lon_deg,height_m,vel_n_mps,vel_e_mps,vel_d_mps,roll_deg,pitch_deg,"
        "heading_deg,std_pos_n_m,std_pos_e_m,std_pos_d_m,mood"
    )
    np.savetxt(path, table, "%.10f", ",", header=head, comments="")


#: Format, file, and how it is written.
WRITE: dict[str, tuple[str, Callable[[Path, Reference], None]]] = {
    "ginav": ("a.pos", write_ginav),
    "great_ins": ("a.ins", write_great_ins),
    "tum": ("a.tum", write_tum),
    "kfgins_nav": ("a.nav", write_nav),
    "csv": ("a.csv", write_csv),
}
