"""The changes that `mutants.py` makes one at a time, and who must notice each.

Invariant: ``before`` stands in the file as it is now; a fault that the stress suite at its small size does not reach
names the unit test that does.
"""

from typing import NamedTuple


class Mutant(NamedTuple):
    """A change of one file, and the tests that must notice."""

    name: str
    tests: str  # of the stress suite, N1,N2; or a test for pytest
    file: str
    before: str
    after: str


MUTANTS = [
    Mutant("fastmath", "N3,N7", "jit.py", '"fastmath": False', '"fastmath": True'),
    Mutant("contract", "N3", "jit.py", '"fastmath": False', '"fastmath": {"contract"}'),
    Mutant(
        "moeller-trumbore",  # weights from the edges at one vertex: neighbours decide their edge apart
        "N3",
        "rays/predicate.py",
        "    low = min(u, v, w)\n    high = max(u, v, w)\n    if low > e or high < -e:\n",
        "    v = ax * (cy - ay) - ay * (cx - ax)\n"
        "    w = (bx - ax) * ay - (by - ay) * ax\n"
        "    u = ((by - ay) * (cx - ax) - (bx - ax) * (cy - ay)) - v - w\n"
        "    low = min(u, v, w)\n"
        "    high = max(u, v, w)\n"
        "    if not (low >= 0.0 or high <= 0.0):\n"
        "        return False, 0.0, u, v, w\n"
        "    if low == low:\n",
    ),
    Mutant(
        "no-exact-sign",  # Woop's watertight test alone: shared edges count twice
        "N3",
        "rays/predicate.py",
        "    if low > e or high < -e:\n",
        "    if not (low >= 0.0 or high <= 0.0):\n        return False, 0.0, u, v, w\n    if low == low:\n",
    ),
    Mutant("no-tie-rule", "N1", "rays/predicate.py", "(1 if py > qy else -1)", "1"),
    Mutant("t-of-slivers", "N3", "rays/predicate.py", "fma(px, qy, -right) + rest", "px * qy - right"),
    Mutant(
        "contracted-shear",
        "N3",
        "rays/predicate.py",
        "        (ax - ox) - sx * az,\n",
        "        fma(-sx, az, ax - ox),\n",
    ),
    Mutant(
        "leaf-of-strangers",
        "tests/tracer/accel/test_wide.py::test_mixes_of_fine_and_coarse_meshes",
        "accel/collapse.py",
        "first if beside else _int32(_SCATTERED)",
        "first",
    ),
    Mutant(
        "edge-lost-in-packets",  # < becomes <=
        "N2",
        "rays/packet_leaf.py",
        "(low < zero) & (high > zero)",
        "(low <= zero) & (high > zero)",
    ),
    Mutant(
        "edge-lost-in-tiles",
        "N2",
        "rays/tile_leaf.py",
        "(low < zero) & (high > zero)",
        "(low <= zero) & (high > zero)",
    ),
    Mutant(
        "beam-too-narrow",
        "N2",
        "rays/tile_beam.py",
        "return 2.0**-20 * (2.0 * reach + half) + 8.0 * slop",
        "return -(2.0**-16) * (2.0 * reach + half)",
    ),
    Mutant("tmin-lost-in-tiles", "N2", "rays/tile_leaf.py", "nearer & (t > t_min)", "nearer & (t > zero)"),
    Mutant("no-pad", "N1,N2,N5", "rays/start.py", "return r, p - pad, p + pad,", "return r, p, p,"),
    Mutant(
        "near-is-far",  # an absent child is met by all then, and leads to the root: no end
        "N1",
        "rays/start.py",
        "select(negative, _i64(NODE_HIGH + row), _i64(row))",
        "select(negative, _i64(row), _i64(NODE_HIGH + row))",
    ),
    Mutant(
        "least-id-lost",
        "N4",
        "rays/leaf_four.py",
        "t == best and primitive <",
        "False and primitive <",
    ),
    Mutant(
        "least-id-lost-in-packets",
        "N4",
        "rays/packet_leaf.py",
        "(t == t_best) & (splat(INTEGERS, primitive) < best)",
        "(t == t_best) & (splat(INTEGERS, primitive) > best)",
    ),
    Mutant(
        "packets-without-slop",
        "tests/tracer/rays/test_rays_packet.py::test_from_far_away",
        "rays/packet.py",
        "slop = 2.0**-46 * (1.0",
        "slop = 0.0 * (1.0",
    ),
    Mutant(
        "packets-without-rounding",  # 0 is within what boxes and lines are rounded outward by themselves
        "tests/tracer/rays/test_rays_packet.py::test_specks",
        "rays/packet.py",
        "_ROUNDING: Final = 2.0**-21",
        "_ROUNDING: Final = -(2.0**-21)",
    ),
    Mutant(
        "given-up-for-good",  # what a packet has found before it is given up stays
        "N2",
        "rays/packet_start.py",
        "if primitive != load(_int64, ray + PRIMITIVE):",
        "if load(_int64, ray + PRIMITIVE) < 0:",
    ),
    Mutant(
        "skip-lost-alone",
        "tests/tracer/rays/test_rays_packet.py::test_origins_on_the_surface",
        "rays/packet_start.py",
        "load(INTEGERS, four + SKIP))",
        "none)",
    ),
    Mutant(
        "light-lost-in-a-packet-given-up",
        "tests/tracer/rays/test_rays_packet.py::test_light_through_closed_meshes",
        "rays/packet.py",
        "if dimmed & active != 0:",
        "if False:",
    ),
    Mutant(
        "squares-overflow",
        "tests/tracer/rays/test_paths.py::test_any_power_of_two",
        "rays/start.py",
        "_SQUARES: Final = 2.0**60",
        "_SQUARES: Final = 2.0**70",
    ),
    Mutant(
        "cubes-overflow",
        "tests/tracer/rays/test_paths.py::test_any_power_of_two",
        "rays/start.py",
        "_CUBES: Final = 2.0**38",
        "_CUBES: Final = 2.0**50",
    ),
    Mutant(
        "cubes-vanish",
        "tests/tracer/rays/test_paths.py::test_any_power_of_two",
        "rays/start.py",
        "_LEAST_CUBES: Final = 2.0**-22",
        "_LEAST_CUBES: Final = 2.0**-60",
    ),
    Mutant(
        "sole-whatever-its-edges",  # a triangle that ends within the beam speaks for all of it
        "tests/numerics/test_beams.py",
        "rays/packet.py",
        "if verdict != ACROSS or (ended != NONE and not coincide(place, row, packet, size)):",
        "if ended != NONE and not coincide(place, row, packet, size):",
    ),
    Mutant(
        "covered-but-not-certain",  # the predicate would have decided such rays exactly
        "tests/numerics/test_packet_cut.py",
        "rays/packet_cut.py",
        "sure = reach * reach * splat(VECTOR, 4.0 * CERTAIN)",
        "sure = reach * splat(VECTOR, 0.0)",
    ),
    Mutant(
        "dark-at-the-lamp-itself",
        "tests/numerics/test_corners.py",
        "rays/packet_corners.py",
        "on_the_way = all_lanes((weighted > off) & (past < -off) & (total > total_off))",
        "on_the_way = True",
    ),
    Mutant(
        "eye-on-the-plane",
        "tests/tracer/integrators/test_integrators_corners.py::test_an_eye_on_the_face",
        "rays/packet_corners.py",
        "if within and all_lanes(size_of > weighted_off) else UNSURE",
        "if within else UNSURE",
    ),
    Mutant(
        "mirror-of-any-normal",  # what a tilted normal mirrors does not come from one point
        "tests/tracer/integrators/test_integrators_corners.py::test_a_mirror_with_a_normal_of_its_own_is_asked_ray_by_ray",
        "integrators/corners.py",
        "_SAME: Final = 2.0**-50",
        "_SAME: Final = 2.0**1",
    ),
    Mutant(
        "samples-out-of-order",
        "tests/tracer/integrators/test_integrators_corners.py::test_a_mesh_finer_than_pixels",
        "integrators/places.py",
        "store(points + 2 * ROW + 8 * place, k)",
        "store(points + 2 * ROW + 8 * place, place)",
    ),
    Mutant(
        "apart-by-no-margin",  # a triangle that ends at the corner ray itself
        "N2",
        "rays/packet_corners.py",
        "_EDGE: Final = 2.0**-44",
        "_EDGE: Final = -(2.0**-10)",
    ),
    Mutant(
        "brute-without-margin", "N2", "rays/brute_sift.py", "_MARGIN: Final = 2.0**-13", "_MARGIN: Final = 2.0**-30"
    ),
    Mutant("brute-without-slack", "N2", "rays/brute_sift.py", "_SLACK: Final = 2.0**-15", "_SLACK: Final = 2.0**-40"),
    Mutant("brute-from-afar", "N2", "rays/brute_sift.py", "_FAR: Final = 2.0 ", "_FAR: Final = 1e6 "),
    Mutant("any-quadrilateral", "N2", "rays/brute_table.py", "_SAME: Final = 2.0**-26", "_SAME: Final = 2.0**-2"),
    Mutant(
        "corners-of-other-pixels",
        "tests/tracer/integrators/test_integrators_corners.py::test_any_number_of_samples[12]",
        "integrators/survey.py",
        "x + _FINE * (fine & 1)",
        "x + 0 * (fine & 1)",
    ),
    Mutant(
        "corners-a-pixel-short",
        "tests/tracer/integrators/test_integrators_corners.py::test_any_number_of_samples[12]",
        "integrators/survey.py",
        "float(x + side), float(y + side)",
        "float(x + side - 1), float(y + side - 1)",
    ),
    Mutant(
        "plane-through-the-wrong-side",
        "tests/tracer/integrators/test_integrators_plain.py::test_the_back_of_a_wall",
        "integrators/plain.py",
        "if c > 0.0 and view",
        "if c < 0.0 and view",
    ),
    Mutant(
        "open-meshes-have-an-inside",
        "tests/tracer/render/test_render_solids.py::test_where_there_is_none",
        "render/inside.py",
        "return bool(total == np.uint64(0))",
        "return True",
    ),
    Mutant(
        "lamps-within-are-hidden",
        "tests/tracer/render/test_render_solids.py::test_a_lamp_within_the_mesh_or_its_box",
        "shading/solids.py",
        "if abs(off) > _OUTSIDE:",
        "if abs(off) >= 0.0:",
    ),
    Mutant(
        "hidden-by-what-is-behind",
        "tests/tracer/render/test_render_solids.py::test_floor_between_ball_and_lamp",
        "shading/solids.py",
        "between = along > zero",
        "between = along == along",
    ),
    Mutant(
        "shuffled-by-another-pixel",
        "tests/tracer/sampling/test_sampling_lanes.py::test_places_in_a_pixel_are_the_same_points",
        "sampling/lanes.py",
        "(_int64(shuffle) & ((1 << _TABLE_BITS) - 1))",
        "(_int64(shuffle) & ((1 << _TABLE_BITS) - 2))",
    ),
    Mutant(
        "wrong-texel-in-lanes",
        "tests/tracer/shading/test_shading_surfaces.py",
        "shading/texture.py",
        "store(numbers + 16, convert(_int32, row0 + column1))",
        "store(numbers + 16, convert(_int32, row0 + column0))",
    ),
    Mutant(
        "texture-wraps-at-the-wrong-end",
        "tests/numerics/test_texture_lanes.py",
        "shading/texture.py",
        "below, above = (last, zero) if wrap",
        "below, above = (zero, last) if wrap",
    ),
    Mutant(
        "placed-in-the-wrong-frame",  # rays go in by the map to the world
        "N2",
        "rays/placed.py",
        "o, d = _transform(maps, i + MAP_TO_OBJECT, o), _transform(maps, i + MAP_TO_OBJECT, d)",
        "o, d = _transform(maps, i + MAP_TO_OBJECT - 9, o), _transform(maps, i + MAP_TO_OBJECT - 9, d)",
    ),
    Mutant(
        "plain-discriminant",
        "N7",
        "geometry/quadric.py",
        "return _solve(dd, b, x * x + y * y + z * z,",
        "return _solve(dd, b, (o.x * o.x + o.y * o.y + o.z * o.z) - b * b / dd,",
    ),
    Mutant(
        "fixed-offset",  # an epsilon of 1e-4 instead of the derived bound
        "N9",
        "rays/spawn.py",
        "    distance = absolute(normal.x) * error.x + absolute(normal.y) * error.y + absolute(normal.z) * error.z\n",
        "    distance = splat(VECTOR, 1e-4)\n",
    ),
    Mutant(
        "no-offset",
        "N9",
        "rays/spawn.py",
        "return Vec3(away(position.x + x, x), away(position.y + y, y), away(position.z + z, z))",
        "return Vec3(position.x, position.y, position.z)",
    ),
    Mutant(
        "one-frame-for-all",
        "N1",
        "render/parts.py",
        "_RESOLVED: Final = 2.0**18",
        "_RESOLVED: Final = 2.0**200",
    ),
    Mutant(
        "placed-error-lost",
        "N9",
        "accel/placing.py",
        "gamma(32) * (both @ extent)",
        "gamma(0) * (both @ extent)",
    ),
    Mutant(
        "placed-ids-lost",
        "N2",
        "rays/placed.py",
        "load(INTEGERS, mine + PRIMITIVE) + offset",
        "load(INTEGERS, mine + PRIMITIVE)",
    ),
    Mutant(
        "placed-normals-by-the-map",  # not by the inverse transpose
        "N11",
        "shading/surfaces.py",
        "n0 = transform_transposed(view.placement_maps, place + MAP_TO_OBJECT, n0)",
        "n0 = transform(view.placement_maps, place + MAP_TO_WORLD, n0)",
    ),
    Mutant(
        "placed-mirrors-inside-out",
        "N11",
        "shading/surfaces.py",
        "            normal = negate(normal)\n        more",
        "            pass\n        more",
    ),
    Mutant(
        "rests-dropped",
        "N23",
        "integrators/sums.py",
        "return new, lost + ((total - (new - back)) + (value - back))",
        "return new, lost",
    ),
    Mutant(
        "plain-snell",
        "N12",
        "shading/phong.py",
        "square = (1.0 - ratio) * (1.0 + ratio) + along * along",
        "square = 1.0 - ratio * ratio * (1.0 - cosine * cosine)",
    ),
    Mutant(
        "attenuation-unguarded",
        "N18",
        "shading/phong.py",
        "return 1.0 / max(denominator, LEAST_DENOMINATOR) if denominator > 0.0 else 0.0",
        "return 1.0 / denominator",
    ),
    Mutant("empty-intervals-are-searched", "N6", "rays/start.py", "(t_min < t_max)", "(t_min <= t_max)"),
    Mutant(
        "samples-of-the-crop",
        "N22",
        "render/blocks.py",
        "pixel_key(settings[SETTING_SEED], px, py, 0)",
        "pixel_key(settings[SETTING_SEED], px - crop_x, py - crop_y, 0)",
    ),
    Mutant(
        "survey-of-another-block",
        "N22",
        "render/blocks.py",
        "        start_survey(survey)\n",
        "        if block == 0:\n            start_survey(survey)\n",
    ),
    Mutant(
        "corners-at-infinity",
        "N24",
        "loaders/mesh.py",
        "bad = ~_in_range(positions, MAX_COORDINATE)",
        "bad = np.zeros(len(positions), np.bool_)",
    ),
]
