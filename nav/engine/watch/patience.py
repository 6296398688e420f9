"""How long measurements of one kind have been refused in a row: in time, not in numbers.

Ten refusals are ten seconds of evidence from a receiver that reports once a second and one from a
receiver that reports ten times; what they prove about a filter, or about a fault that outlasts its
measurements, is a matter of time.
"""

from __future__ import annotations

#: After an attempt that has failed the next one comes so soon [s].
_AGAIN = 2.0
#: Of the time between two refusals so much counts at most [s]: silence refuses nothing.
_BETWEEN = 2.0


class Patience:
    """Refusals in a row of one kind of measurement.

    Parameters
    ----------
    limit : float
        Time after which patience is at an end [s]; 0: never.
    """

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self._lasted = 0.0
        self._latest: float | None = None
        self._not_before = float("-inf")

    @property
    def lasted(self) -> float:
        """How long the refusals so far have lasted [s]."""
        return self._lasted

    def accepted(self) -> None:
        """Forget all refusals."""
        self._lasted, self._latest = 0.0, None
        self._not_before = float("-inf")

    def refused(self, time: float, weight: float = 1.0) -> None:
        """Take a refusal at `time` [s]; what proves less counts for less of the time."""
        more = self._by(time) - self._lasted
        self._lasted, self._latest = self._lasted + weight * more, time

    def failed(self, time: float) -> None:
        """Take a refusal of what was insisted on: once more, and soon."""
        self._lasted, self._latest = max(self._by(time), self.limit), time
        self._not_before = time + _AGAIN

    def over(self, time: float, limit: float | None = None) -> bool:
        """Tell if one more refusal at `time` [s] would be one too many.

        Parameters
        ----------
        time : float
        limit : float, optional
            In place of the usual limit, where there is better evidence [s].
        """
        if self.limit <= 0.0 or self._latest is None or time < self._not_before - 1e-3:
            return False
        return self._by(time) >= (self.limit if limit is None else limit) - 1e-3

    def _by(self, time: float) -> float:
        if self._latest is None:
            return 0.0
        return self._lasted + min(time - self._latest, _BETWEEN)
