"""How the IMU sits in its vehicle, as a run knows it in the end, and whether that was used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..filters.rotation import FloatArray, rpy_from_matrix


@dataclass(frozen=True, eq=False)
class Installation:
    """Mounting and wheel point.

    Parameters
    ----------
    off : str
        Why no constraint of the vehicle made use of it; '' where one did.
    source : str
        'estimated', or where it is declared.
    C_bv : ndarray, shape (3, 3)
        Mounting, ``C_bv @ x_v == x_b``.
    mounting_cov : ndarray, shape (2, 2)
        Covariance of its pitch and yaw about the vehicle's own axes [rad²]; 0: exact.
    wheel_v : ndarray, shape (3,)
        From the IMU to the point the wheels constrain, vehicle axes [m].
    wheel_sigma : ndarray, shape (2,)
        1σ of it, forward and down [m]; 0: exact.
    """

    off: str
    source: str
    C_bv: FloatArray
    mounting_cov: FloatArray
    wheel_v: FloatArray
    wheel_sigma: FloatArray

    @property
    def pitch_yaw(self) -> FloatArray:
        """Of the IMU seen from the vehicle, as mountings are declared [rad], shape (2,).

        Of the direction of motion in IMU axes, f = C_bv (1, 0, 0)ᵀ: roll about it is in nothing
        that is measured.
        """
        f = self.C_bv[:, 0]
        return np.array([np.arcsin(np.clip(f[2], -1.0, 1.0)), -np.arctan2(f[1], f[0])])

    @property
    def pitch_yaw_sigma(self) -> FloatArray:
        """1σ of `pitch_yaw` [rad], shape (2,)."""
        f = self.C_bv[:, 0]
        # δf = C_bv ((0, pitch, yaw) × (1, 0, 0)) = C_bv (0, yaw, −pitch)
        df = np.column_stack([-self.C_bv[:, 2], self.C_bv[:, 1]])
        flat = max(float(f[0] ** 2 + f[1] ** 2), 1e-12)
        J = np.array([df[2] / np.sqrt(flat), -(f[0] * df[1] - f[1] * df[0]) / flat])
        sigma: FloatArray = np.sqrt(np.einsum("ij,jk,ik->i", J, self.mounting_cov, J))
        return sigma

    @property
    def estimated(self) -> bool:
        """Whether any of it was a state."""
        return bool(self.mounting_cov.any() or self.wheel_sigma.any())

    def __str__(self) -> str:
        """Return the line a run says of it."""
        if self.off:
            return f"nhc off: {self.off}"
        if not np.isfinite([*self.mounting_cov.ravel(), *self.wheel_v]).all():
            return "nhc on: mounting not known, the solution was lost"
        (pitch, yaw), (s_pitch, s_yaw) = np.degrees([self.pitch_yaw, self.pitch_yaw_sigma])
        forward, _, down = self.wheel_v
        if not self.estimated:
            return (
                f"nhc on: mounting yaw {yaw:+.1f}°, pitch {pitch:+.1f}°, wheels {forward:+.2f} m "
                f"forward and {down:+.2f} m down of the IMU ({self.source}, taken as exact)"
            )
        return (
            f"nhc on: mounting yaw {yaw:+.1f}° ± {s_yaw:.1f}°, pitch {pitch:+.1f}° ± "
            f"{s_pitch:.1f}°, wheels {forward:+.2f} ± {self.wheel_sigma[0]:.2f} m forward and "
            f"{down:+.2f} ± {self.wheel_sigma[1]:.2f} m down of the IMU (estimated)"
        )

    def figures(self) -> dict[str, Any]:
        """Return it for summary.json."""
        (pitch, yaw), (s_pitch, s_yaw) = np.degrees([self.pitch_yaw, self.pitch_yaw_sigma])
        return {
            "nhc": "off" if self.off else "on",
            "why_off": self.off or None,
            "source": self.source,
            "yaw_deg": yaw,
            "yaw_sigma_deg": s_yaw,
            "pitch_deg": pitch,
            "pitch_sigma_deg": s_pitch,
            "mounting_rpy_deg": np.degrees(rpy_from_matrix(self.C_bv.T)),
            "wheels_frd_m": self.C_bv @ self.wheel_v,
            "wheels_vehicle_m": self.wheel_v,
            "wheels_vehicle_sigma_m": self.wheel_sigma,
        }
