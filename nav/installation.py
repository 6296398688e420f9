"""How IMU and antenna sit in their vehicle, as a run knows it in the end, and what used it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..filters.rotation import FloatArray, rpy_from_matrix

#: A constant is observed that is known to so much of what was known before.
_OBSERVED = 0.5


@dataclass(frozen=True, eq=False)
class AntennaPlace:
    """Place of the antenna and time stamps of GNSS.

    Parameters
    ----------
    lever_b : ndarray, shape (3,)
        From the IMU, body axes [m].
    sigma, prior_sigma : ndarray, shape (3,)
        1σ now and before the data [m]; 0: exact.
    delay, delay_sigma, delay_prior_sigma : float
        By how much GNSS is later than stamped, and 1σ now and before the data [s]; 0: exact.
    """

    lever_b: FloatArray
    sigma: FloatArray
    prior_sigma: FloatArray
    delay: float = 0.0
    delay_sigma: float = 0.0
    delay_prior_sigma: float = 0.0

    @property
    def observed(self) -> NDArray[np.bool_]:
        """Whether the motion has shown forward, right, down, and the delay, shape (4,)."""
        now = np.append(self.sigma, self.delay_sigma)
        return np.asarray(now < _OBSERVED * np.append(self.prior_sigma, self.delay_prior_sigma))

    def lines(self) -> list[str]:
        """Return what a run says of it: nothing where both are exact."""
        out = []
        *seen, timed = self.observed
        if self.prior_sigma.any():
            parts = [
                f"{value:+.2f} ± {sigma:.2f} m {axis}{'' if ok else ' (not observed)'}"
                for value, sigma, ok, axis in zip(
                    self.lever_b, self.sigma, seen, ("forward", "right", "down"), strict=True
                )
            ]
            out.append(f"antenna {', '.join(parts)} of the IMU (estimated)")
        if self.delay_prior_sigma:
            what = "estimated" if timed else "not observed"
            out.append(
                f"GNSS is {self.delay:+.3f} ± {self.delay_sigma:.3f} s later than stamped ({what})"
            )
        return out

    def figures(self) -> dict[str, Any]:
        """Return it for summary.json."""
        *seen, timed = map(bool, self.observed)
        return {
            "lever_frd_m": self.lever_b,
            "lever_sigma_m": self.sigma,
            "lever_observed": seen,
            "delay_s": self.delay,
            "delay_sigma_s": self.delay_sigma,
            "delay_observed": timed,
        }


@dataclass(frozen=True, eq=False)
class Installation:
    """Mounting, wheel point and antenna.

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
    antenna : AntennaPlace
    """

    off: str
    source: str
    C_bv: FloatArray
    mounting_cov: FloatArray
    wheel_v: FloatArray
    wheel_sigma: FloatArray
    antenna: AntennaPlace

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
            "antenna": self.antenna.figures(),
        }
