"""Statistics of a fit's residuals: degrees of freedom, whiteness, identifiability, held-out errors.

Pure functions of :class:`jackbox_env.fits.least_squares.Rows` and :class:`jackbox_env.fits.least_squares.Chain`:
residuals r and their Jacobian J by the scene's fields and the windows' starts.
:mod:`jackbox_env.fits.outcome` uses them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jackbox_env.fits.least_squares import FAR, FARTHEST, UNIDENTIFIABLE, Chain, Rows
from jackbox_env.model.states import Array

_LAGS = 4  # rows, up to which residuals are compared


def highest_mean_square(count: int) -> float:
    """Mean square of ``count`` residuals, in units of their noise, above which they are more than noise."""
    return 1.5 + 9.0 / math.sqrt(count)


def mean_squares(rows: Rows, windows: int) -> tuple[Array, Array]:
    """Mean square residual of each window, and what is more than noise, both (windows,); 0 and inf of one unseen.

    What was discounted counts as if it was least far, so that a window may have a bad row.
    """
    seen = (rows.column >= 0) | (rows.column == FAR)
    counts = np.bincount(rows.window[seen], minlength=windows)
    squares = np.where(rows.column == FAR, FARTHEST**2, rows.residuals**2)[seen]
    most = np.array([highest_mean_square(count) if count else np.inf for count in counts.tolist()])
    return np.bincount(rows.window[seen], squares, windows) / np.maximum(counts, 1), most


def misfitting(rows: Rows, windows: int) -> NDArray[np.bool_]:
    """The windows that do not fit, shape (windows,): their mean square residual is far above that of most."""
    square, most = mean_squares(rows, windows)
    usual = max(1.0, float(np.median(square[square > 0.0]))) if (square > 0.0).any() else 1.0
    return np.asarray(square > most * usual)


def autocorrelations(rows: Rows) -> Array:
    """Autocorrelation of the residuals of each column and of all, lags 1 to 4 together, within windows, shape (14,).

    In units of its standard deviation for white noise; a little less on average if the model is right, because what is
    fitted takes some of it away. 0 for columns of fewer than 12 residuals.
    """
    sums, counts = np.zeros(14), np.zeros(14)
    for column in range(13):
        of_column = rows.column == column
        residuals, window = rows.residuals[of_column], rows.window[of_column]
        for lag in range(1, _LAGS + 1) if len(residuals) >= 12 else ():
            together = window[lag:] == window[:-lag]
            sums[column] += (residuals[lag:] * residuals[:-lag])[together].sum()
            counts[column] += together.sum()
    sums[13], counts[13] = sums.sum(), counts.sum()
    return np.asarray(sums / np.sqrt(np.maximum(counts, 1.0)))


def identified(chain: Chain) -> tuple[Array, Array]:
    """Covariance of the fields' numbers, (F, F), and the unidentifiable combinations, of length 1, (k, F)."""
    fields = chain.rows.fields
    _, values, directions = np.linalg.svd(chain.information(), full_matrices=True)
    deviations = np.full(fields, np.inf)
    deviations[: len(values)] = 1.0 / np.maximum(values, 1e-300)
    unidentifiable = (deviations > UNIDENTIFIABLE) | (deviations > 1e8 * deviations.min())
    known = directions[~unidentifiable]
    return known.T @ (deviations[~unidentifiable, None] ** 2 * known), directions[unidentifiable]


def unidentified_sentence(names: Sequence[str], direction: Array) -> str:
    """A combination of fields that the recordings leave open, in words."""
    shares = (direction / direction[np.argmax(abs(direction))]).tolist()
    moved = [(name, share) for name, share in zip(names, shares, strict=True) if abs(share) > 0.05]
    if len(moved) == 1:
        return f"the recordings do not identify {moved[0][0]}"
    moves = [f"{name} by {share:+.2g} %" for name, share in moved]
    return f"moving {' and '.join(moves)} changes nothing that was observed"
