"""The residual of a filter: innovations with their covariances, whitened, and how likely they are.

log L = -1/2 sum(log det S_k + rho(z_k^T S_k^-1 z_k)) of innovations z_k with covariances S_k. rho is the identity up to
TAIL^2 and grows with the logarithm beyond: a fix that is far off counts as one that is off.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

TAIL = 3.0  # number of sigmas beyond which the likelihood decreases with the logarithm of an innovation only
FEWEST_LASTING = 50  # smallest number of innovations from which autocorrelations are estimated
LASTING = 30  # largest lag of the autocorrelations, in fixes


@dataclass(frozen=True)
class Residual:
    """Innovations of one run, by the fixes used (f,): z (f, 2) north-east m, s (f, 3) covariance nn, ne, ee, m^2; NaN
    where a fix was not applied. yaw (f,) rad and velocity (f, 2) m/s of the prediction.

    beside (f, 2, b): innovation and variance of each of the other scalar residuals since the last fix (heights,
    constraints); NaN without one. missing (f,): the likelihood of those that this run lacks (`counting`)."""

    z: np.ndarray
    s: np.ndarray
    yaw: np.ndarray
    velocity: np.ndarray
    beside: np.ndarray | None = None
    missing: np.ndarray | None = None

    def __post_init__(self):
        if self.beside is None:
            object.__setattr__(self, 'beside', np.empty((len(self.z), 2, 0)))
        if self.missing is None:
            object.__setattr__(self, 'missing', np.zeros(len(self.z)))

    def log_likelihood(self) -> np.ndarray:
        """The likelihood of each innovation, (f,), without the constant."""
        determinant = self.s[:, 0] * self.s[:, 2] - self.s[:, 1] ** 2
        of_fixes = -0.5 * (np.log(determinant) + tempered(self.nis()))
        return of_fixes + np.nan_to_num(_of_scalars(self.beside)).sum(axis=1) + self.missing

    def counting(self, there: np.ndarray) -> Residual:
        """The same with the scalar residuals `there`, (f, b) bool, alone: so that the likelihoods of all runs are of
        the same residuals.

        The parameters of a filter decide at which times it applies a constraint. The likelihood of one standstill is
        about 10, so a model that applied it more often would seem more likely. A residual that is missing counts as the
        mean of the others of its kind, one that is not `there` does not count.
        """
        beside = np.where(there[:, None], self.beside, np.nan)
        each = _of_scalars(beside)
        seen = np.isfinite(each)
        mean = np.where(seen, each, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        return replace(self, beside=beside, missing=(there & ~seen) @ mean)

    @property
    def of_fixes(self) -> Residual:
        """The innovations of the positions alone."""
        return replace(self, beside=None, missing=None)

    def nis(self) -> np.ndarray:
        """Normalized innovation squared, (f,)."""
        return (self.whitened() ** 2).sum(axis=1)

    def factors(self):
        """Cholesky factors of the covariances: l_nn, l_en, l_ee, (f,) each."""
        l_nn = np.sqrt(self.s[:, 0])
        l_en = self.s[:, 1] / l_nn
        return l_nn, l_en, np.sqrt(self.s[:, 2] - l_en**2)

    def whitened(self) -> np.ndarray:
        """S^(-1/2) z, (f, 2): independent and of unit variance where the model is right."""
        return whiten(self.factors(), self.z)

    def along_across(self) -> np.ndarray:
        """Whitened innovations along and across the track, (f, 2)."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        turned = np.stack([c * self.z[:, 0] + s * self.z[:, 1], c * self.z[:, 1] - s * self.z[:, 0]], axis=1)
        nn, ne, ee = self.s.T
        rotated = np.stack([c * c * nn + 2 * c * s * ne + s * s * ee, (c * c - s * s) * ne + c * s * (ee - nn),
                            s * s * nn - 2 * c * s * ne + c * c * ee], axis=1)
        return replace(self, z=turned, s=rotated).whitened()


def _of_scalars(beside: np.ndarray) -> np.ndarray:
    """The likelihood of each scalar residual, (f, b), without the constant; NaN without one."""
    z, s = beside[:, 0], beside[:, 1]
    return -0.5 * (np.log(s) + tempered(z**2 / s))


def tempered(nis: np.ndarray, tail: float = TAIL) -> np.ndarray:
    """rho: `nis` up to tail^2, growing with its logarithm beyond."""
    return np.where(nis > tail**2, tail**2 * (1 + np.log(np.maximum(nis, 1e-12) / tail**2)), nis)


def lasting(beside: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(b,): factor on the variance of a mean of many innovations because they are correlated, from their
    autocorrelations up to the lag LASTING or the first negative one (M. S. Bartlett, 1946). 1 with too few of them."""
    found = np.ones(beside.shape[2])
    for k in range(len(found)):
        z, s = beside[mask, :, k].T
        u = z / np.sqrt(s)
        there = np.isfinite(u)
        if there.sum() < FEWEST_LASTING or not np.any(u[there]):
            continue
        u = np.where(there, np.clip(u, -TAIL, TAIL), 0.0)
        power = (u**2).sum() / there.sum()
        for lag in range(1, LASTING):
            pairs = (there[lag:] & there[:-lag]).sum()
            rho = (u[lag:] * u[:-lag]).sum() / max(pairs, 1) / power
            if pairs < FEWEST_LASTING or rho < 0:
                break
            found[k] += 2 * rho
    return found


def whiten(factors, z):
    l_nn, l_en, l_ee = factors
    first = z[:, 0] / l_nn
    return np.stack([first, (z[:, 1] - l_en * first) / l_ee], axis=1)


def whiten_matrix(factors, s):
    """L^-1 S L^-T of symmetric matrices (f, 3) nn, ne, ee."""
    l_nn, l_en, l_ee = factors
    nn = s[:, 0] / l_nn**2
    ne = (s[:, 1] / l_nn - l_en * nn) / l_ee
    ee = (s[:, 2] - 2 * l_en * s[:, 1] / l_nn + l_en**2 * nn) / l_ee**2
    return np.stack([nn, ne, ee], axis=1)
