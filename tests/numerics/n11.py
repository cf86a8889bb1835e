"""N11: instances under shear, scales of 1e-6 to 1e6, mirrors and up to four steps: distance, point, normals, side.

A map is made of up to four steps of the scene document, composed by the document's own arithmetic; the truth is their
exact composition. With kappa = ||S1| .. |Sn|| ||inverse|| (sizes of the steps' linear parts, largest row sums), errors
are counted in eps kappa, eps = 2**-53: of the hit along the true normal, relative to what it is computed from (corners,
the origin as seen from the place, the way); of unit normals absolutely, the geometric one beside what its triangle's
shape costs, |e1| |e2| / |e1 x e2|. Oracle: exact rationals, roots in mpmath. The same for baked meshes in the note.
"""

from fractions import Fraction

import mpmath
import numpy as np
from row import Row

from tests.tracer.rays.packets import find_closest
from tests.tracer.rays.placements import place, random_turn, rows_of
from tests.tracer.shading.hits import meet
from tracer.scene.transforms import IDENTITY, multiplied
from tracer.shading.rows import GEOMETRIC, NORMAL, POSITION

EPS = 2.0**-53
RAYS = 8
KINDS = ("turn", "scale", "stretch", "shear", "mirror")


def step(kind, rng):
    """The linear part of a step."""
    if kind == "turn":
        return random_turn(rng)
    if kind == "scale":
        return np.eye(3) * 10.0 ** rng.uniform(-6, 6)
    if kind == "stretch":
        return np.diag(10.0 ** rng.uniform(-2, 2, 3))
    if kind == "shear":
        m = np.eye(3)
        m[tuple(rng.permutation(3)[:2])] = 10.0 ** rng.uniform(-2, 2)
        return m
    return np.diag(rng.permutation([1.0, 1.0, -1.0]))


def exact(matrix):
    return [[Fraction(float(x)) for x in row] for row in matrix]


def product(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(len(b))) for j in range(len(b[0]))] for i in range(len(a))]


def cofactors(m):
    """The transposed inverse times the determinant, and the determinant."""
    c = [
        [
            m[(i + 1) % 3][(j + 1) % 3] * m[(i + 2) % 3][(j + 2) % 3]
            - m[(i + 1) % 3][(j + 2) % 3] * m[(i + 2) % 3][(j + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]
    return c, sum(m[0][j] * c[0][j] for j in range(3))


def norm(m):
    return float(max(sum(abs(x) for x in row) for row in m))


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def cross(a, b):
    return [a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3] for k in range(3)]


def unit(v):
    with mpmath.workdps(40):
        w = [mpmath.mpf(x.numerator) / x.denominator for x in v]
        size = mpmath.sqrt(sum(x * x for x in w))
        return [x / size for x in w]


def draw(rng):
    """A map: (rows by the document's arithmetic, exact rows, kappa)."""
    rows, truth = IDENTITY, exact(IDENTITY)
    sizes = exact(np.eye(3))
    for _ in range(rng.integers(1, 5)):
        linear = step(rng.choice(KINDS), rng)
        matrix = rows_of(linear, rng.uniform(-1, 1, 3) * np.abs(linear).max() * (rng.random() < 0.5))
        rows, truth = multiplied(matrix, rows), product(exact(matrix), truth)
        sizes = product(exact(np.abs(linear)), sizes)
    c, determinant = cofactors([row[:3] for row in truth[:3]])
    inverse = [[c[j][i] / determinant for j in range(3)] for i in range(3)]
    return rows, truth, norm(sizes) * norm(inverse)


def errors_of(scene, faces, corners, given, truth, kappa, shape, origins, directions):
    """Largest errors of a map's hits in eps kappa: (along the normal, geometric normal, shading normal), and wrong sides."""
    hits = find_closest(scene, origins, directions)
    k = np.flatnonzero(hits.primitive >= 0)
    if len(k) == 0:
        return np.zeros(3), 0, 0
    packet, behind = meet(
        scene, origins[k], directions[k], hits.primitive[k], t=hits.t[k], u=hits.uv[k, 0], v=hits.uv[k, 1]
    )
    points, geometric, shading = packet.get(POSITION), packet.get(GEOMETRIC), packet.get(NORMAL)
    shading[behind] *= -1  # the material is two-sided
    transposed, determinant = cofactors([row[:3] for row in truth[:3]])
    sign = 1 if determinant > 0 else -1
    place_of = [row[3] for row in truth[:3]]
    worst, wrong = np.zeros(3), 0
    for n, ray in enumerate(k):
        a, b, c = (corners[i] for i in faces[hits.primitive[ray] % len(faces)])
        normal = [sign * x for x in cross(minus(b, a), minus(c, a))]
        o, d = [Fraction(x) for x in origins[ray]], [Fraction(x) for x in directions[ray]]
        across = unit(normal)
        t = dot(normal, minus(a, o)) / dot(normal, d)
        strays = abs(float(Fraction(hits.t[ray]) - t) * float(dot(across, [float(x) for x in d])))
        off = abs(float(dot(across, [float(x) for x in minus([Fraction(x) for x in points[n]], a)])))
        size = max(float(abs(x)) for p in (a, b, c) for x in p) + max(float(abs(x)) for x in minus(o, place_of))
        size += max(abs(float(t * x)) for x in d)
        worst[0] = max(worst[0], max(strays, off) / (EPS * kappa * size))
        smooth = across if given is None else unit([sign * dot(row, given) for row in transposed])
        for kind, (found, true) in enumerate(((geometric[n], across), (shading[n], smooth))):
            error = max(abs(float(x - float(y))) for x, y in zip(true, found, strict=True))
            condition = kappa * (shape if kind == 0 or given is None else 1.0)
            worst[1 + kind] = max(worst[1 + kind], error / (EPS * condition))
        wrong += bool(behind[n]) != (dot(normal, d) > 0)
    return worst, wrong, len(k)


def run(cases, seed=11):
    rng = np.random.default_rng(seed)
    total = wrong = bare_wrong = 0
    worst, bare = np.zeros(3), np.zeros(3)
    greatest = 0.0
    while total < cases:
        rows, truth, kappa = draw(rng)
        greatest = max(greatest, kappa)
        vertices, faces = rng.standard_normal((3, 3)), np.array([[0, 1, 2]])
        e1, e2 = vertices[1:] - vertices[0]
        area = np.linalg.norm(np.cross(e1, e2))
        shape = np.linalg.norm(e1) * np.linalg.norm(e2) / area
        smooth = rng.random() < 0.5  # else the triangle's own normal says which side is which
        normal = np.cross(e1, e2) / area
        far = rows_of(np.eye(3), [1e30, 0, 0])
        normals = [np.tile(normal, (3, 1))] if smooth else None
        placed = place([(vertices, faces)], [(0, rows), (0, far)], normals=normals)
        given = [Fraction(x) for x in normal] if smooth else None
        corners = [[dot(row[:3], [Fraction(x) for x in v]) + row[3] for row in truth[:3]] for v in vertices]
        world = np.array([[float(x) for x in p] for p in corners])
        aims = rng.dirichlet((1, 1, 1), RAYS) @ world
        size = np.abs(world - world.mean(0)).max()
        origins = aims + rng.standard_normal((RAYS, 3)) * size * 10.0 ** rng.uniform(-1, 1, (RAYS, 1))
        case = (faces, corners, given, truth, kappa, shape, origins, aims - origins)
        found, sides, n = errors_of(placed.scene, *case)
        worst, wrong, total = np.maximum(worst, found), wrong + sides, total + max(n, 1)
        found, sides, _ = errors_of(placed.baked, *case)
        bare, bare_wrong = np.maximum(bare, found), bare_wrong + sides
    names = ("point", "geometric normal", "shading normal")
    note = ", ".join(f"{name} {x:.2g}" for name, x in zip(names, worst, strict=True))
    note += f"; wrong side {wrong}; kappa up to {greatest:.0e}; baked: "
    note += ", ".join(f"{name} {x:.2g}" for name, x in zip(names, bare, strict=True)) + f", wrong side {bare_wrong}"
    return Row("N11", "instances", total, wrong, float(worst.max()), 4.0, note)
