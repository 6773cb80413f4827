"""What is wrong with the innovations, before anybody asks why."""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..characterization.autocorrelation import ljung_box
from .residuals import Residual

LAGS = 10  # fixes over which autocorrelations are tested
#: level of the test of whiteness, all components together
COLOURED = 0.005
#: level of the test of the mean, which small model errors move first
SHIFTED = 0.001
COMPONENTS = ('north', 'east', 'along track', 'across track')


@dataclass(frozen=True)
class Detection:
    """Tests of whitened innovations, which should be white, of unit variance and of mean zero.

    nis_mean: mean normalized innovation squared, 2 where the model is right; nis_bounds: its 99 % interval then. mean
    and mean_p, whiteness_p, to_next (correlation of each with the next one): by component. ljung_box_p: the smallest
    whiteness_p, times four. count: innovations.
    """

    nis_mean: float
    nis_bounds: tuple[float, float]
    mean: dict[str, float]
    mean_p: dict[str, float]
    whiteness_p: dict[str, float]
    to_next: dict[str, float]
    ljung_box_p: float
    count: int

    @property
    def alternates(self) -> bool:
        """Innovations change sign from one to the next, where they are least white: the filter's gain is too large."""
        return self.to_next[min(COMPONENTS, key=self.whiteness_p.__getitem__)] < 0.0

    @property
    def consistent(self) -> bool:
        """Neither the size nor the order nor the mean of the innovations speaks against the model."""
        low, high = self.nis_bounds
        return (low <= self.nis_mean <= high and self.ljung_box_p >= COLOURED
                and 4 * min(self.mean_p.values()) >= SHIFTED)

    @property
    def lacking(self) -> bool:
        """The model lacks something: not consistent, and not for expecting more than there is."""
        low, _ = self.nis_bounds
        return not replace(self, nis_mean=max(self.nis_mean, low)).consistent

    def words(self) -> list[str]:
        """What is wrong, for a person."""
        low, high = self.nis_bounds
        said = []
        if self.nis_mean > high:
            said.append(f'The innovations are {np.sqrt(self.nis_mean / 2):.2g} times as large as the filter expects '
                        f'(NIS {self.nis_mean:.3g}, {low:.2f} to {high:.2f} expected).')
        elif self.nis_mean < low:
            said.append(f'The innovations are smaller than the filter expects (NIS {self.nis_mean:.3g}, '
                        f'{low:.2f} to {high:.2f} expected): its noise is set too high.')
        coloured = [name for name in COMPONENTS if self.whiteness_p[name] < COLOURED / 4]
        if coloured:
            said.append(f"They are not white ({', '.join(coloured)}): each tells something of the next, " + (
                'which has the other sign: the filter follows the fixes too closely.' if self.alternates else
                'so the filter makes an error that lasts.'))
        shifted = [f'{name} by {self.mean[name]:+.2f} sigma' for name in COMPONENTS
                   if self.mean_p[name] < SHIFTED / 4]
        if shifted:
            said.append(f"Their mean is not zero: {', '.join(shifted)}.")
        return said or ['The innovations are white, centred and as large as the filter expects.']


def detect(residual: Residual, mask: np.ndarray) -> Detection:
    """The tests on the innovations in `mask`."""
    from scipy.stats import chi2, norm

    mask = mask & np.isfinite(residual.z[:, 0])  # what the filter refused says nothing of the others
    u, t = residual.whitened()[mask], residual.along_across()[mask]
    series = dict(zip(COMPONENTS, [*u.T, *t.T]))
    n = len(u)
    whiteness = {name: ljung_box(values, LAGS) for name, values in series.items()}
    to_next = {name: _to_next(values) for name, values in series.items()}
    mean = {name: float(values.mean()) for name, values in series.items()}
    mean_p = {name: float(2 * norm.sf(abs(m) * np.sqrt(n))) for name, m in mean.items()}
    bounds = tuple(float(b) / n for b in chi2.ppf([0.005, 0.995], 2 * n))
    return Detection(float((u**2).sum() / n), bounds, mean, mean_p, whiteness, to_next,
                     min(1.0, 4 * min(whiteness.values())), n)


def _to_next(values: np.ndarray) -> float:
    """Correlation of each of the values (n,) with the next one; 0 where they are all the same."""
    centred = values - values.mean()
    return float(centred[:-1] @ centred[1:] / max(centred @ centred, np.finfo(float).tiny))
