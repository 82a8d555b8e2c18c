"""Semi-global matching: the recursion is optimal on a line, the kernels are the recursion, the scenes come right."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.reconstruction.census import match_census
from stereocal.reconstruction.matching_costs import COST_MAX, COSTS, RECIPES
from stereocal.reconstruction.semiglobal import DIRECTIONS, jump_penalties, match_sgm, path_costs, sum_paths
from stereocal.reconstruction.semiglobal_sweeps import match_by_sweeps, rows_of_strip
from stereocal.reconstruction.winner import Search, select

cv2 = pytest.importorskip("cv2")


@settings(max_examples=20)
@given(seed=seeds, length=st.integers(1, 6), D=st.integers(1, 4), backwards=st.booleans())
def test_a_path_is_the_best_of_all_labellings(seed, length, D, backwards) -> None:
    """On a line, min_d L(p, d) plus the minima taken off is the least energy over ALL sequences d_1 … d_p."""
    rng = np.random.default_rng(seed)
    C = rng.integers(0, COST_MAX + 1, (1, length, D)).astype(np.int64)
    image = rng.integers(0, 256, (1, length)).astype(np.uint8)
    P1, penalties = 5, jump_penalties(5, 60, 20.0)
    L = path_costs(C, image, P1, penalties, (-1 if backwards else 1, 0))[0]
    order = range(length)[:: -1 if backwards else 1]
    energy = 0
    for before, _ in itertools.pairwise(order):
        energy += L[before].min()
    energy += L[order[-1]].min()

    def of(labels: tuple[int, ...]) -> int:
        total = 0
        for n, x in enumerate(order):
            total += C[0, x, labels[n]]
            if n:
                step = abs(labels[n] - labels[n - 1])
                jump = int(penalties[abs(int(image[0, x]) - int(image[0, order[n - 1]]))])
                # A step of one costs P1, any other P2; where the adapted P2 is the cheaper, it is a jump.
                total += 0 if step == 0 else min(P1, jump) if step == 1 else jump
        return total

    assert energy == min(of(labels) for labels in itertools.product(range(D), repeat=length))


@settings(max_examples=60)
@given(
    seed=seeds,
    shape=st.tuples(st.integers(1, 13), st.integers(1, 26)),
    count=st.integers(1, 50),
    lowest=st.integers(-9, 9),
    cost=st.sampled_from(COSTS),
    paths=st.sampled_from(sorted(DIRECTIONS)),
    tolerance=st.sampled_from([None, 0, 1, 2]),
    uniqueness=st.sampled_from([0, 5, 30]),
    scale=st.sampled_from([None, 4.0, 50.0]),
    coarse=st.booleans(),
)
def test_kernels_are_the_recursion(
    seed, shape, count, lowest, cost, paths, tolerance, uniqueness, scale, coarse
) -> None:
    rng = np.random.default_rng(seed)
    scene = rng.integers(0, 256, (shape[0], shape[1] + 9)).astype(np.uint8)
    if coarse:  # many ties
        scene = scene // 100 * 100
    left, right = scene[:, : shape[1]], scene[:, 4 : 4 + shape[1]]
    P1 = int(rng.integers(0, 190))
    options = {
        "num_disparities": count,
        "min_disparity": lowest,
        "cost": cost,
        "paths": paths,
        "left_right_check": tolerance,
        "uniqueness_ratio": uniqueness,
        "gradient_scale": scale,
        "block_size": int(rng.choice([1, 3, 5])),
        "subpixel": bool(rng.integers(2)),
        "P1": P1,
        "P2": int(rng.integers(P1 + 1, 192)),
        "speckle_size": int(rng.choice([0, 6])),
        "median": bool(rng.integers(2)),
        "texture_threshold": int(rng.choice([0, 8, 90])),
    }
    expected = match_sgm(left, right, **options, backend="numpy")
    result = match_sgm(left, right, **options, threads=int(rng.integers(1, 3)))
    assert result.dtype == np.float32
    np.testing.assert_array_equal(result, expected)


@pytest.mark.parametrize("paths", sorted(DIRECTIONS))
@pytest.mark.parametrize(("height", "rows"), [(1, 1), (2, 1), (37, 5), (37, 19), (40, 7), (40, 100)])
def test_checkpoints_change_nothing(paths, height, rows) -> None:
    rng = np.random.default_rng(height)
    left, right = rng.integers(0, 256, (2, height, 40)).astype(np.uint8)
    search, recipe = Search(16, 0, True, 1, 0), RECIPES["census+bt"]
    penalties = jump_penalties(10, 60, 20.0)
    maps = [
        match_by_sweeps(left, right, recipe, 3, search, 10, penalties, paths, threads, strip)
        for threads, strip in ((1, height), (1, rows), (2, rows))
    ]
    np.testing.assert_array_equal(maps[1], maps[0])
    np.testing.assert_array_equal(maps[2], maps[0])


def test_calls_at_the_same_time_do_not_share_memory() -> None:
    rng = np.random.default_rng(11)
    pairs = [rng.integers(0, 256, (2, 40, 60)).astype(np.uint8) for _ in range(8)]
    one_by_one = [match_sgm(*pair, num_disparities=16) for pair in pairs]
    with ThreadPoolExecutor(4) as pool:
        at_once = list(pool.map(lambda pair: match_sgm(*pair, num_disparities=16), pairs))
    for a, b in zip(one_by_one, at_once, strict=True):
        np.testing.assert_array_equal(a, b)


def test_large_images_go_by_strips() -> None:
    assert rows_of_strip(480, 640 * 64) == 240
    assert rows_of_strip(960, 1280 * 128) == 31


def test_more_paths_see_more() -> None:
    """The sum over 8 paths is the sum over the four of the cross and the four diagonals, each counted once."""
    rng = np.random.default_rng(0)
    C = rng.integers(0, 65, (6, 7, 5)).astype(np.int64)
    image = rng.integers(0, 256, (6, 7)).astype(np.uint8)
    penalties = jump_penalties(10, 60, None)
    assert len(set(DIRECTIONS[8])) == 8
    rest = [path_costs(C, image, 10, penalties, r) for r in set(DIRECTIONS[8]) - set(DIRECTIONS[4])]
    np.testing.assert_array_equal(
        sum_paths(C, image, 10, penalties, 8), sum_paths(C, image, 10, penalties, 4) + sum(rest)
    )


def test_penalties_fall_with_the_gradient() -> None:
    penalties = jump_penalties(34, 142, 20.0).astype(int)
    assert penalties[0] == 142
    assert penalties[20] == 71
    assert penalties[255] == 35
    assert np.all(np.diff(penalties) <= 0)
    assert np.all(jump_penalties(34, 142, None) == 142)


@settings(max_examples=12)
@given(seed=seeds, shift=st.integers(-8, 14), cost=st.sampled_from(COSTS), paths=st.sampled_from(sorted(DIRECTIONS)))
def test_a_constant_shift_is_found(seed, shift, cost, paths) -> None:
    """Physics, no oracle: every pixel that both cameras see gets the shift, and no pixel beyond gets an answer."""
    scene = np.random.default_rng(seed).integers(0, 256, (40, 140)).astype(np.uint8)
    left, right = scene[:, 20:120], scene[:, 20 + shift : 120 + shift]
    d = match_sgm(left, right, num_disparities=32, min_disparity=-12, cost=cost, paths=paths)
    x = np.arange(100)
    well_inside = (x - shift >= 3) & (x - shift < 97) & (x >= 3) & (x < 97)
    assert np.all(np.abs(d[:, well_inside] - shift) < 0.25)
    outside = (x - shift < -2) | (x - shift > 101)
    assert np.isfinite(d[:, outside]).sum() <= 0.02 * d[:, outside].size


def _slanted_pair(rng, slope, height=80, width=200):
    """A plane d = 6 + slope · x with a random band-limited texture, sampled exactly in both images."""
    phases, frequencies = rng.uniform(0, 2 * np.pi, 60), rng.uniform(0.1, 1.3, 60)
    weights, rows = rng.uniform(0.3, 1, 60), rng.uniform(-0.8, 0.8, (60, 1))

    def texture(x, y):
        waves = weights[:, None, None] * np.sin(
            frequencies[:, None, None] * x + rows[:, :, None] * y + phases[:, None, None]
        )
        return waves.sum(axis=0)

    y, x = np.mgrid[:height, :width].astype(float)
    truth = 6 + slope * x
    left = texture(x, y)
    right = texture((x + 6) / (1 - slope), y)  # x' = x − 6 − slope x
    low, high = left.min(), left.max()
    return truth, *(
        np.clip((view - low) / (high - low) * 255, 0, 255).round().astype(np.uint8) for view in (left, right)
    )


@pytest.mark.parametrize("slope", [0.02, 0.08, -0.02])
def test_a_slanted_plane_is_followed_to_a_fraction_of_a_pixel(slope) -> None:
    truth, left, right = _slanted_pair(np.random.default_rng(4), slope)
    d = match_sgm(left, right, num_disparities=32)
    seen = np.zeros(d.shape, bool)
    seen[4:-4, 30:-10] = True
    assert np.isfinite(d[seen]).mean() > 0.98
    error = (d - truth)[seen & np.isfinite(d)]
    assert np.sqrt(np.mean(error**2)) < 0.2
    assert abs(error.mean()) < 0.03
    whole = match_sgm(left, right, num_disparities=32, subpixel=False)
    assert np.nanstd((whole - truth)[seen]) > 1.4 * error.std()


def test_what_only_the_left_camera_sees_has_no_answer() -> None:
    """A square in front of a wall hides a strip of the wall, to its left, from the right camera."""
    rng = np.random.default_rng(7)
    wall, square = rng.integers(0, 256, (80, 240)), rng.integers(0, 256, (40, 50))
    left, right = wall[:, 20:180].copy(), wall[:, 24:184].copy()  # the wall at d = 4
    left[20:60, 70:120], right[20:60, 54:104] = square, square  # the square at d = 16
    d = match_sgm(left.astype(np.uint8), right.astype(np.uint8), num_disparities=32)
    hidden = d[24:56, 59:69]
    assert np.isnan(hidden).mean() > 0.9
    assert np.all(np.abs(d[24:56, 74:116] - 16) < 0.25)
    assert np.all(np.abs(d[64:, 10:150] - 4) < 0.25)


def test_texture_on_one_side_carries_over_a_blank_patch() -> None:
    """What the smoothness is for: a blank patch in a textured wall gets the wall's disparity."""
    rng = np.random.default_rng(8)
    scene = rng.integers(0, 256, (60, 180))
    scene[20:40, 90:110] = 128
    left, right = scene[:, 10:170].astype(np.uint8), scene[:, 19:179].astype(np.uint8)
    d = match_sgm(left, right, num_disparities=32)
    assert np.mean(np.abs(d[20:40, 80:100] - 9) < 0.5) > 0.99


def test_a_tie_of_neighbours_goes_to_the_smaller_and_any_other_has_no_answer() -> None:
    volume = np.full((1, 12, 4), 7, np.int64)
    volume[..., 1:3] = 3
    assert np.all(select(volume, Search(4, 0, False, -1, 0))[:, 1:] == 1)
    volume[..., 3] = 3
    assert np.isnan(select(volume, Search(4, 0, False, -1, 0))).all()


def test_a_blank_image_has_no_answer_where_nothing_is_smoothed() -> None:
    blank = np.full((30, 90), 77, np.uint8)
    assert np.isnan(match_census(blank, blank, num_disparities=16)[:, 30:]).all()


SGBM = {"P1": 8 * 25, "P2": 32 * 25, "disp12MaxDiff": 0, "preFilterCap": 0, "uniquenessRatio": 10}


@pytest.mark.parametrize("name", ["motorcycle", "teddy", "tsukuba"])
def test_better_than_opencv_on_middlebury(data, name) -> None:
    """Fewer bad pixels than MODE_HH over all and over non-occluded pixels; no disparity counts as bad."""
    left, right, truth, visible, count = middlebury(data, name)
    opencv = cv2.StereoSGBM_create(
        0, count, 5, **SGBM, speckleWindowSize=100, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_HH
    ).compute(left, right)
    maps = match_sgm(left, right, num_disparities=count), np.where(opencv < 0, np.nan, opencv / 16.0)
    for region in (np.isfinite(truth), visible):
        for limit in (1.0, 2.0):
            ours, theirs = (1 - np.mean(np.abs(d - truth)[region] <= limit) for d in maps)
            assert ours < theirs
    assert np.isfinite(maps[0]).mean() > np.isfinite(maps[1]).mean()


def middlebury(data, name):
    """Grey pair, true disparity (NaN unknown), where it is visible in the right image too, and the search range."""
    if name == "motorcycle":
        files, count = ("motorcycle_left.png", "motorcycle_right.png"), 64
        truth = np.load(data / name / "motorcycle_disp.npz")["arr_0"].astype(float)
    elif name == "teddy":
        files, count = ("im2.png", "im6.png"), 64
        truth = cv2.imread(str(data / name / "disp2.pgm"), cv2.IMREAD_UNCHANGED) / 4.0
    else:
        files, count = ("scene1.row3.col3.ppm", "scene1.row3.col4.ppm"), 16
        truth = cv2.imread(str(data / name / "truedisp.row3.col3.pgm"), cv2.IMREAD_UNCHANGED) / 16.0
    truth[~np.isfinite(truth) | (truth == 0)] = np.nan
    left, right = (cv2.imread(str(data / name / file), cv2.IMREAD_GRAYSCALE) for file in files)
    y, x = np.nonzero(np.isfinite(truth))
    d = truth[y, x]
    there = np.rint(x - d).astype(int)
    real = there >= 0
    nearest = np.full(truth.shape, -np.inf)
    np.maximum.at(nearest, (y[real], there[real]), d[real])
    visible = np.zeros(truth.shape, bool)
    visible[y[real], x[real]] = d[real] >= nearest[y[real], there[real]] - 1
    return left, right, truth, visible, count


def test_bad_input_is_named() -> None:
    image = np.zeros((10, 12), np.uint8)
    for options, words in (
        ({"cost": "ssd"}, "cost must be one of"),
        ({"paths": 6}, "paths must be 4, 5 or 8"),
        ({"paths": [8]}, "paths must be 4, 5 or 8"),
        ({"speckle_range": -1.0}, "speckle_range"),
        ({"P1": 50, "P2": 50}, "P2 must be from 51 to 191"),
        ({"P2": 300}, "P2 must be from"),
        ({"gradient_scale": 0.0}, "gradient_scale"),
        ({"num_disparities": 0}, "num_disparities"),
        ({"block_size": 4}, "odd"),
        ({"block_size": 51}, "smaller block"),
        ({"texture_threshold": -1}, "texture_threshold"),
        ({"threads": 0}, "threads"),
        ({"backend": "cuda"}, "backend"),
    ):
        with pytest.raises(InputError, match=words):
            match_sgm(image, image, **options)
    with pytest.raises(InputError, match="one size"):
        match_sgm(image, image[:5])
