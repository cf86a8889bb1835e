"""N12, N18, N19: refraction, attenuation and the highlight's power against mpmath."""

import math

import mpmath
import numpy as np
from row import Row

from tracer.jit import kernel
from tracer.shading.phong import attenuation, refract_direction
from tracer.simd import power
from tracer.types import Vec3

EPS = 2.0**-53


@kernel
def refract_all(directions, normals, ratios, passed, refracted):
    for i in range(len(ratios)):
        d = Vec3(directions[i, 0], directions[i, 1], directions[i, 2])
        n = Vec3(normals[i, 0], normals[i, 1], normals[i, 2])
        ok, t = refract_direction(d, n, ratios[i])
        passed[i] = ok
        refracted[i, 0], refracted[i, 1], refracted[i, 2] = t.x, t.y, t.z


@kernel
def attenuate_all(rows, values):
    for i in range(len(rows)):
        values[i] = attenuation(rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3])


@kernel
def shine_all(rows, values):
    for i in range(len(rows)):
        values[i] = power(max(0.0, rows[i, 0]), rows[i, 1])


def run(cases, seed=12):
    """Snell: the tangential part is ratio times the incident one; total reflection decided right outside rounding."""
    rng = np.random.default_rng(seed)
    ratios = rng.uniform(0.25, 4, cases)
    ratios[rng.random(cases) < 0.1] = 1.0
    sines = rng.random(cases)
    critical = (ratios > 1) & (rng.random(cases) < 0.5)
    sines[critical] = 1 / ratios[critical] * (1 + rng.integers(-64, 65, critical.sum()) * EPS)
    grazing = rng.random(cases) < 0.1
    cosines = np.sqrt((1 - sines) * (1 + sines))
    cosines[grazing] = 10.0 ** rng.uniform(-16, -4, grazing.sum())
    sines[grazing] = np.sqrt((1 - cosines[grazing]) * (1 + cosines[grazing]))
    normals = np.zeros((cases, 3))
    normals[:, 2] = 1.0
    directions = np.stack([sines, np.zeros(cases), -cosines], -1)
    passed, refracted = np.empty(cases, np.bool_), np.empty((cases, 3))
    refract_all(directions, normals, ratios, passed, refracted)
    wrong, worst = 0, 0.0
    with mpmath.workdps(50):
        for i in range(cases):
            ratio, cosine = mpmath.mpf(float(ratios[i])), mpmath.mpf(float(cosines[i]))
            square = 1 - ratio**2 * (1 - cosine**2)
            if bool(passed[i]) != (square >= 0):
                wrong += abs(square) > 16 * EPS * ratio**2
            elif passed[i]:
                want = ratio * mpmath.mpf(float(sines[i]))
                got = mpmath.mpf(float(refracted[i, 0]))
                if want > 0:
                    worst = max(worst, float(abs(got - want) / (want * 2 * EPS)))
                wrong += ratios[i] == 1.0 and not np.array_equal(refracted[i], directions[i])
            wrong += not np.isfinite(refracted[i]).all()
    return Row(
        "N12",
        "refraction against mpmath (Snell, total reflection)",
        cases,
        int(wrong),
        worst,
        4.0,
        "ulp; R + T waits for Fresnel",
    )


def run_attenuation(cases, seed=18):
    rng = np.random.default_rng(seed)
    rows = np.where(rng.random((cases, 4)) < 0.2, 0.0, 10.0 ** rng.uniform(-8, 8, (cases, 4)))
    far = rng.random(cases)
    rows[far < 0.1, 3] = 1e154
    rows[(far > 0.1) & (far < 0.2), 3] = 0.0
    rows[far > 0.97, 3] = math.inf
    values = np.empty(cases)
    attenuate_all(rows, values)
    wrong = int((~np.isfinite(values)).sum())
    worst = 0.0
    with mpmath.workdps(50):
        for (a, b, c, distance), value in zip(rows.tolist(), values.tolist(), strict=True):
            below = (
                mpmath.mpf(a)
                if math.isinf(distance)
                else mpmath.mpf(a) + mpmath.mpf(b) * distance + mpmath.mpf(c) * mpmath.mpf(distance) ** 2
            )
            if below == 0:
                wrong += value != 0.0
            elif 1 / below > 1e-300:
                worst = max(worst, float(abs(mpmath.mpf(value) * below - 1) / EPS))
    return Row("N18", "attenuation against mpmath", cases, wrong, worst, 8.0, "in 2^-53")


def run_power(cases, seed=19):
    rng = np.random.default_rng(seed)
    rows = np.stack([rng.random(cases), 10.0 ** rng.uniform(-3, 9, cases)], -1)
    rows[: cases // 3, 0] = 1 - 10.0 ** rng.uniform(-16, -1, cases // 3)
    rows[cases // 3 : cases // 2, 0] = 10.0 ** rng.uniform(-300, -1, cases // 2 - cases // 3)
    rows[-4:] = [[0.0, 0.0], [1.0, 1e9], [0.0, 1e9], [-1.0, 5.0]]
    values = np.empty(cases)
    shine_all(rows, values)
    wrong, worst = int((~np.isfinite(values)).sum()), 0.0
    with mpmath.workdps(50):
        for (cosine, exponent), value in zip(rows.tolist(), values.tolist(), strict=True):
            want = mpmath.mpf(max(0.0, cosine)) ** mpmath.mpf(exponent)
            if want > 1e-300:
                worst = max(worst, float(abs(mpmath.mpf(value) / want - 1) / (2 * EPS)))
            else:
                wrong += not 0.0 <= value <= 1e-299
    return Row("N19", "highlight's power against mpmath", cases, wrong, worst, 8.0, "ulp")
