"""Cameras and rigs to draw from: any lens of a model, near the identity and far from it."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from stereocal.base.rotations import rotation_matrix
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig

PARAMETERS = {"pinhole": 0, "polynomial": 2, "brown": 5, "rational": 8, "thin_prism": 12, "tilted": 14, "fisheye": 4}

_numbers = st.floats(-0.5, 0.5, allow_nan=False).map(lambda x: 0.0 if abs(x) < 1e-300 else x)
_focal = st.floats(50, 5000)
_size = st.tuples(st.integers(16, 5000), st.integers(16, 5000))


@st.composite
def cameras(draw, models=tuple(PARAMETERS), *, skew=False, image_size=None, zero_from=None):
    """A camera; parameters from index `zero_from` on are 0."""
    model = draw(st.sampled_from(models))
    size = draw(_size) if image_size is None else image_size
    dist = draw(st.lists(_numbers, min_size=PARAMETERS[model], max_size=PARAMETERS[model]))
    if zero_from is not None:
        dist[zero_from:] = [0.0] * len(dist[zero_from:])
    s = draw(st.floats(-5, 5)) if skew else 0.0
    K = [[draw(_focal), s, draw(st.floats(0, 4000))], [0, draw(_focal), draw(st.floats(0, 4000))], [0, 0, 1]]
    return Camera(K, dist, size, model=model)


@st.composite
def rigs(draw, models=tuple(PARAMETERS), *, skew=False, zero_from=None, one_model=False):
    """A rig of two cameras of one image size."""
    size = draw(_size)
    if one_model:
        models = (draw(st.sampled_from(models)),)
    left, right = (draw(cameras(models, skew=skew, image_size=size, zero_from=zero_from)) for _ in range(2))
    R = rotation_matrix(draw(st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3)))
    T = np.array([-draw(st.floats(20, 400)), draw(st.floats(-10, 10)), draw(st.floats(-10, 10))])
    return StereoRig(left, right, R, T)


@st.composite
def ordinary_rigs(draw, *, zero_from=None):
    """A rig as people have them, whose lenses can be undone over the whole image: what rectification needs.

    Numbers are whole multiples of 1e-7: a lens parameter of 1e-151 tests the rectification's arithmetic, not a format.
    """

    def between(low: float, high: float) -> float:
        return round(draw(st.floats(low, high)), 7)

    size = draw(st.sampled_from([(640, 480), (320, 240), (1280, 720)]))
    f = size[0] * between(0.6, 1.5)

    def camera() -> Camera:
        K = [
            [f * between(0.98, 1.02), 0, size[0] / 2 + between(-20, 20)],
            [0, f, size[1] / 2],
            [0, 0, 1],
        ]
        dist = [
            between(-0.3, 0.0),
            between(0.05, 0.15),
            *(between(-1e-3, 1e-3) for _ in "pp"),
            0.0,
        ]
        if zero_from is None:
            dist[4] = between(-0.01, 0.01)
        return Camera(K, dist, size)

    R = rotation_matrix([between(-0.05, 0.05) for _ in "xyz"])
    T = [-between(20, 400), between(-3, 3), between(-3, 3)]
    return StereoRig(camera(), camera(), R, T)


def mapped_alike(first: Camera, second: Camera) -> bool:
    """Whether two cameras have the same image size and the same K, and their lenses are the same function."""
    a, b = (np.concatenate([camera.dist, np.zeros(14 - len(camera.dist))]) for camera in (first, second))
    fisheye = (first.model == "fisheye") == (second.model == "fisheye")
    same_size = first.image_size == second.image_size
    return fisheye and same_size and np.array_equal(first.K, second.K) and np.array_equal(a, b)
