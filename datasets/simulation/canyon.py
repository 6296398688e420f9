"""What buildings do to satellite signals: blockage, diffraction at roof edges, reflection.

Every block of the street network gets two rows of buildings whose heights depend only on the
city's seed and the block, so a street looks the same on the second visit. A signal whose line
of sight meets a wall loses power as at a knife edge; one that is then too weak to track may
still arrive by reflection at a facade. The reflection is geometric: the receiver is mirrored
in the facade, so that extra path, direction of arrival and Doppler belong together.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray
from .streets import Block

#: Carrier wavelength the diffraction is computed for, GPS L1 [m].
_WAVELENGTH = 0.190293673
_ANTENNA_HEIGHT = 2.0
#: Length of one building along the street [m].
_CELL = 30.0


@dataclass(frozen=True)
class Density:
    """Statistics of the buildings along a street.

    Parameters
    ----------
    half_width : (float, float)
        Range of the distance from the middle of the street to the facades [m].
    height : float
        Median height [m]; heights are log-normal.
    spread : float
        σ of the logarithm of the height.
    open_share : float
        Blocks without buildings (plazas, parks).
    canyon_share : float
        Blocks with buildings of 30–60 m on both sides.
    gap_share : float
        Single missing buildings.
    tunnel_share : float
        Blocks with an underpass of 30–60 m.
    """

    half_width: tuple[float, float]
    height: float
    spread: float
    open_share: float
    canyon_share: float
    gap_share: float
    tunnel_share: float


#: Numbers are chosen, not surveyed: 'urban' is meant to span 0–12 visible satellites.
DENSITIES = {
    "open": Density((20.0, 30.0), 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
    "suburb": Density((14.0, 22.0), 8.0, 0.3, 0.2, 0.0, 0.3, 0.0),
    "urban": Density((9.0, 14.0), 25.0, 0.5, 0.15, 0.3, 0.1, 0.08),
    "canyon": Density((8.0, 11.0), 45.0, 0.3, 0.0, 0.6, 0.02, 0.08),
}


@dataclass(frozen=True, eq=False)
class Sight:
    """What stands between n receiver positions and m satellites.

    Parameters
    ----------
    loss : ndarray, shape (n, m)
        Of the direct signal [dB]; infinite underground.
    reflected : ndarray of bool, shape (n, m)
        Whether a facade also sends the signal.
    reflection_loss : ndarray, shape (n, m)
        Of the reflected signal [dB].
    wall_point, wall_normal : ndarray, shape (n, m, 3)
        A point of that facade and its horizontal unit normal on the receiver's side, north,
        east, down [m]; meaningless where not reflected.
    """

    loss: FloatArray
    reflected: np.ndarray
    reflection_loss: FloatArray
    wall_point: FloatArray
    wall_normal: FloatArray


@dataclass(frozen=True, eq=False)
class _Buildings:
    """One block: heights [m] of the cells left and right of its northward/eastward direction."""

    height: FloatArray  # (2, cells)
    half_width: float
    tunnel: tuple[float, float]
    reflects: FloatArray  # (satellites,), uniform draws
    crosswise: FloatArray
    tilt: FloatArray
    reflection_loss: FloatArray


@dataclass
class City:
    """A city of one density; asks for no memory of the blocks but their names.

    Parameters
    ----------
    density : {'open', 'suburb', 'urban', 'canyon'}
    seed : int
    nlos_probability : float
        That a blocked satellite of a block has a facade to be reflected at.
    """

    density: str
    seed: int
    nlos_probability: float = 0.3
    _known: dict[tuple[int, ...], _Buildings] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.density not in DENSITIES:
            raise ConfigError.unknown_key(self.density, DENSITIES, where="density")

    def _buildings(self, block: Block, satellites: int) -> _Buildings:
        if block.key not in self._known:
            self._known[block.key] = _build(
                DENSITIES[self.density], block.length, satellites, (self.seed, *block.key)
            )
        return self._known[block.key]

    def sight(
        self,
        blocks: tuple[Block, ...],
        index: np.ndarray,
        position_t: FloatArray,
        azimuth: FloatArray,
        elevation: FloatArray,
    ) -> Sight:
        """Return blockage and reflections.

        Parameters
        ----------
        blocks : tuple of Block
        index : ndarray of int, shape (n,)
            The block each position is in.
        position_t : ndarray, shape (n, 3)
            Antenna, north, east, down [m].
        azimuth, elevation : ndarray, shape (n, m)
            Of the satellites [rad].
        """
        shape = azimuth.shape
        out = Sight(
            loss=np.zeros(shape),
            reflected=np.zeros(shape, dtype=bool),
            reflection_loss=np.zeros(shape),
            wall_point=np.zeros((*shape, 3)),
            wall_normal=np.zeros((*shape, 3)),
        )
        for k in np.unique(index):
            rows = index == k
            buildings = self._buildings(blocks[k], shape[1])
            view = _View.of(blocks[k], buildings, position_t[rows], azimuth[rows], elevation[rows])
            out.loss[rows] = view.loss()
            found, point, normal = view.reflection(self.nlos_probability)
            out.reflected[rows] = found & np.isfinite(out.loss[rows])
            out.reflection_loss[rows] = buildings.reflection_loss
            out.wall_point[rows] = point
            out.wall_normal[rows] = normal
        return out


def knife_edge_loss(nu: FloatArray) -> FloatArray:
    """Return the diffraction loss [dB] of the parameter ν (ITU-R P.526-15, eq. 31).

    ν > 0 in the shadow; 6 dB at grazing incidence; nothing below ν = −0.78.
    """
    x = np.maximum(nu, -0.78) - 0.1
    return np.where(nu > -0.78, 6.9 + 20.0 * np.log10(np.sqrt(x**2 + 1.0) + x), 0.0)


def _build(density: Density, length: float, satellites: int, seed: tuple[int, ...]) -> _Buildings:
    """Draw the buildings of one block and how they reflect each satellite."""
    rng = np.random.default_rng(seed)
    cells = int(np.ceil(length / _CELL))
    kind = rng.random()
    if kind < density.open_share:
        height = np.zeros((2, cells))
    elif kind < density.open_share + density.canyon_share:
        height = rng.uniform(30.0, 60.0, (2, cells))
    else:
        height = density.height * np.exp(density.spread * rng.standard_normal((2, cells)))
        height[rng.random((2, cells)) < density.gap_share] = 0.0
    tunnel = (np.inf, np.inf)
    if rng.random() < density.tunnel_share:
        extent = rng.uniform(30.0, 60.0)
        middle = rng.uniform(0.5 * extent, length - 0.5 * extent)
        tunnel = (middle - 0.5 * extent, middle + 0.5 * extent)
    return _Buildings(
        height=height,
        half_width=float(rng.uniform(*density.half_width)),
        tunnel=tunnel,
        reflects=rng.random(satellites),
        crosswise=rng.random(satellites),
        tilt=np.radians(rng.uniform(-15.0, 15.0, satellites)),
        reflection_loss=rng.uniform(6.0, 15.0, satellites),
    )


@dataclass(frozen=True, eq=False)
class _View:
    """Positions and directions in the axes of one street: along it and to its right."""

    buildings: _Buildings
    length: float
    corner_t: FloatArray  # (2,)
    axes_t: FloatArray  # (2, 2): rows along, right
    down: FloatArray  # (n, 1)
    along: FloatArray  # (n, 1)
    across: FloatArray
    ahead: FloatArray  # (n, m) horizontal direction cosines
    right: FloatArray
    elevation: FloatArray

    @classmethod
    def of(
        cls,
        block: Block,
        buildings: _Buildings,
        position_t: FloatArray,
        azimuth: FloatArray,
        elevation: FloatArray,
    ) -> _View:
        north = block.key[2] == 0
        axes_t = np.array([[1.0, 0.0], [0.0, 1.0]] if north else [[0.0, 1.0], [-1.0, 0.0]])
        along, across = axes_t @ (position_t[:, :2] - block.corner_t).T
        horizontal = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        return cls(
            buildings=buildings,
            length=block.length,
            corner_t=block.corner_t,
            axes_t=axes_t,
            down=position_t[:, 2:],
            along=along[:, None],
            across=across[:, None],
            ahead=horizontal @ axes_t[0],
            right=horizontal @ axes_t[1],
            elevation=elevation,
        )

    def _wall(self, right: np.ndarray, ahead: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return horizontal distance to the facade and its height above the antenna.

        `right` says on which side; `ahead` is the direction along the street. The crossing
        streets at both ends are gaps as wide as this street; beyond them the last building
        stands for what follows.
        """
        b = self.buildings
        distance = np.where(right, b.half_width - self.across, b.half_width + self.across)
        # Cutting a corner leaves the street's own width; the wall then stays 2 m away.
        distance = np.maximum(distance, 2.0) / np.maximum(np.abs(self.right), 1e-6)
        place = self.along + ahead * distance
        cell = np.clip(place / _CELL, 0, b.height.shape[1] - 1).astype(int)
        height = b.height[right.astype(int), cell]
        beyond = np.maximum(-place, place - self.length)
        gap = (beyond > 0.0) & (beyond < 2.0 * b.half_width)
        return distance, np.where(gap, 0.0, height) - _ANTENNA_HEIGHT

    def loss(self) -> FloatArray:
        """Return the loss of the direct signals [dB]."""
        distance, height = self._wall(self.right > 0.0, self.ahead)
        shadow = np.arctan2(height, distance) - self.elevation
        slant = distance / np.cos(self.elevation)
        nu = 2.0 * np.sin(0.5 * shadow) * np.sqrt(2.0 * slant / _WAVELENGTH)
        loss = np.where(height > 0.0, knife_edge_loss(nu), 0.0)
        low, high = self.buildings.tunnel
        return np.where((self.along > low) & (self.along < high), np.inf, loss)

    def reflection(self, probability: float) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """Return whether a facade reflects each satellite, one of its points and its normal.

        Most reflections come from the other side of the street; they lengthen the path but,
        on a straight street, leave the Doppler alone. The others come from gable walls across
        the street, ahead or behind, and change both.
        """
        b = self.buildings
        satellite_right = self.right > 0.0
        distance, height = self._wall(~satellite_right, self.ahead)
        tall = height > distance * np.tan(self.elevation)
        crosswise = np.broadcast_to(b.crosswise < 0.4, self.right.shape)
        side = np.where(satellite_right, 1.0, -1.0)
        behind = self.ahead < 0.0  # satellite behind: the wall is ahead and looks back
        gable = np.where(
            behind,
            _CELL * np.ceil((self.along + 3.0) / _CELL),
            _CELL * np.floor((self.along - 3.0) / _CELL),
        )
        facing = np.where(behind, -1.0, 1.0)
        n_along = np.where(crosswise, facing * np.cos(b.tilt), 0.0)
        n_right = np.where(crosswise, np.sin(b.tilt), side)
        p_along = np.where(crosswise, gable, self.along)
        p_right = np.where(crosswise, self.across, -side * b.half_width)
        # The satellite must be on the wall's sunny side, and not where the wall hardly acts.
        lit = np.cos(self.elevation) * (n_along * self.ahead + n_right * self.right) > 0.1
        built = (b.height > 0.0).any()
        in_front = crosswise | (side * self.across + b.half_width > 1.0)
        found = (b.reflects < probability) & lit & in_front & np.where(crosswise, built, tall)
        zero = np.zeros_like(n_along)
        normal = np.concatenate(
            [np.stack([n_along, n_right], axis=-1) @ self.axes_t, zero[..., None]], axis=-1
        )
        plane = np.stack([p_along, p_right], axis=-1) @ self.axes_t + self.corner_t
        down = np.broadcast_to(self.down, n_along.shape)[..., None]
        return found, np.concatenate([plane, down], axis=-1), normal
