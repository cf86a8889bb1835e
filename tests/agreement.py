"""Do a renderer's pixels agree with an oracle's? Two measures: at the same sample positions, and up to sampling noise.

Job: the statistics of ``benchmarks/mini_check.py``. Invariant: knows numbers alone; nothing of ``tracer`` is imported.

The noise is reckoned as follows. A pixel of the renderer is the mean of k samples, and the oracle's is the mean of m
samples that are uniform in the pixel and independent. If the renderer is right, its samples are worth what the oracle says at
their positions, so k + m values of the oracle tell the variance s^2 of one sample, and the difference of the two means
has the standard error s sqrt(1/k + 1/m). For the renderer's share s^2/k is too much rather than too little: its samples are
stratified, which makes their mean better than that of independent ones. So z is smaller than normal, never larger.
Taking both sets for s^2 is what keeps a pixel honest that a thin feature touches: where one of the k samples met it and none
of the m, the m alone know of no variance. The values are the oracle's, not the renderer's, so a leak does not widen its
own error bar.

Source of the correction: Sidak 1967.
"""

from statistics import NormalDist

import numpy as np


def beyond(ours, oracle, bound):
    """Return which pixels (n,) of two pictures (n, 3) differ by more than bound times the greater of 1 and the value."""
    return (np.abs(ours - oracle) > bound * np.maximum(1.0, np.abs(oracle))).any(axis=1)


def z_scores(ours, same, independent, bound):
    """Return z (n, 3) of each pixel, and its standard error.

    ``ours`` (n, 3) are means over k samples, ``same`` (n, k, 3) the oracle's values at their positions, ``independent`` (n, m, 3)
    the oracle's at others. What lies within ``bound`` (see beyond) is rounding and counts as no difference. So z is 0 where
    nothing varies and the two agree, and infinite where nothing varies and they do not.
    """
    mean = independent.mean(axis=1)
    variance = np.concatenate([same, independent], axis=1).var(axis=1, ddof=1)
    error = np.sqrt(variance * (1.0 / same.shape[1] + 1.0 / independent.shape[1]))
    difference = ours - mean
    off = np.maximum(np.abs(difference) - bound * np.maximum(1.0, np.abs(mean)), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(off > 0.0, np.sign(difference) * off / error, 0.0)
    return z, error


def bias(ours, independent, error):
    """Return z (3,) of the mean over all pixels, which sees what is too small in each of them."""
    total = (ours - independent.mean(axis=1)).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total == 0.0, 0.0, total / np.sqrt((error**2).sum(axis=0)))


def sidak_limit(significance, n_tests):
    """Return the largest |z| that n_tests independent standard normal numbers stay below but for a chance of ``significance``."""
    of_one = -np.expm1(np.log1p(-significance) / n_tests)
    return -NormalDist().inv_cdf(of_one / 2.0)
