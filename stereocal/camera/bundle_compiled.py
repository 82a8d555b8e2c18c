"""The compiled engine of bundle adjustment: what its kernels read and write, laid out for them.

The kernels (``bundle_kernels``, ``bundle_step_kernels``) take plain arrays. Here measurements and unknowns of a
``bundle.Bundle`` are brought into their order, once, before the iteration begins:

- **Measurements** come by rows (``Bundle.by_axes``), a block as camera, view, first column, end,
  and whether it is the first of its view.
- **Columns.** Of each camera the rows of J that are in use: the block's pose, the free parameters of θ_c, the residual.
- **Unknowns.** Where these go: a block's unknowns are its view's pose (6), the rig's (6; not for camera 0), the free
  parameters of θ_c and, as one more unknown, the residual. `to` says which of the F + 1 shared unknowns each of them is
  (−1: a rig that is held), `factor` what G multiplies it by, `places` where in θ_c it stands.

Rows of F + 1 numbers that the kernels run along are filled up to a multiple of 4, for the sake of vectors.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.compile_ahead import compile_ahead, has_compiled, is_under_way, wait_for
from stereocal.camera.bundle import Bundle, BundleState, NormalEquations
from stereocal.camera.distortion import distortion_model
from stereocal.camera.losses import LOSSES

# The models that the kernels know, how many coefficients of theirs, and what they need beyond brown's five.
_COEFFICIENTS = {"pinhole": 0, "polynomial": 2, "brown": 5, "rational": 8, "thin_prism": 12, "tilted": 14, "fisheye": 4}
_KINDS = {"rational": 1, "thin_prism": 1, "tilted": 2, "fisheye": 3}
_THETA = 19  # fx fy cx cy s and the widest lens


def has_kernel(bundle: Bundle) -> bool:
    """Whether the compiled twin knows this bundle: OpenCV's lenses, a flat board, no priors."""
    return (
        all(model.name in _COEFFICIENTS for model in bundle.models)
        and bundle.shape_basis is None
        and bundle.prior_weights is None
        and bool((np.count_nonzero(bundle.G, axis=1) <= 1).all())
    )


def compile_engine_ahead(bundle: Bundle) -> None:
    """Let another process compile the normal equations of a bundle like this while this one comes to them.

    Of a first calibration that is the longest wait, as long as that for the homographies and the step together.
    """
    from stereocal.camera.bundle_kernels import normal_equations_kernel

    if has_compiled(normal_equations_kernel):
        return
    names, plain = [model.name for model in bundle.models], bundle.whitening is None and bundle.loss == "linear"
    compile_ahead(f"{__name__}:compile_normal_equations({names}, {plain})", normal_equations_kernel)


def compile_normal_equations(names: list[str], plain: bool) -> None:
    """Compile the normal equations for cameras of these models, by evaluating a board of one corner."""
    models = [distortion_model(name) for name in names]
    cameras, parameters = len(models), sum(5 + model.parameter_count for model in models) + 6 * (len(models) - 1)
    numbers = np.arange(cameras)
    bundle = Bundle(
        models, np.zeros((cameras, 3)), np.zeros((cameras, 2)), np.arange(cameras + 1), numbers, np.zeros_like(numbers),
        np.eye(parameters), 1, loss="linear" if plain else "huber",
    )  # fmt: skip
    theta = [np.concatenate([[1.0, 1.0, 0.0, 0.0, 0.0], model.start()]) for model in models]
    eyes, zeros = np.tile(np.eye(3), (cameras, 1, 1)), np.zeros((cameras, 3))
    CompiledEngine(bundle, BundleState(theta, eyes, zeros, np.eye(3)[None], np.array([[0.0, 0.0, 1.0]])))


class CompiledEngine:
    """What ``bundle_solver.NumpyEngine`` does, by kernels.

    Arrays here and there change places when a step is taken.
    """

    def __init__(self, bundle: Bundle, state: BundleState) -> None:
        from stereocal.camera import bundle_kernels, bundle_step_kernels

        self._fill = bundle_kernels.normal_equations_kernel
        self._step = bundle_step_kernels.step_kernel
        free, views, cameras = bundle.G.shape[1], bundle.view_count, len(bundle.models)
        data = bundle.by_axes
        numbers = np.arange(len(bundle.view_of_block))
        first = np.zeros(views, dtype=np.int64)  # block of each view: from the last on, so that the first one stays
        first[bundle.view_of_block[::-1]] = numbers[::-1]
        blocks = np.empty((len(numbers), 5), dtype=np.int64)
        blocks[:, 0], blocks[:, 1] = bundle.camera_of_block, bundle.view_of_block
        blocks[:, 2], blocks[:, 3] = bundle.offsets[:-1], bundle.offsets[1:]
        blocks[:, 4] = first[bundle.view_of_block] == numbers
        whitening = np.zeros((4, 0)) if bundle.whitening is None else bundle.whitening.reshape(-1, 4).T
        lenses = [_COEFFICIENTS[model.name] for model in bundle.models]
        kinds = [_KINDS.get(model.name, 0) for model in bundle.models]
        columns, places, sizes, to, factor = _unknowns(bundle.G, lenses, bundle_kernels.STRIDE, bundle_kernels.LAST)
        plain = bundle.whitening is None and bundle.loss == "linear"
        self._problem = (
            data, np.ascontiguousarray(whitening), blocks, None if plain else LOSSES.index(bundle.loss),
            float(bundle.loss_scale), np.array(lenses), np.array(kinds) if any(kinds) else None, columns, sizes, to,
            factor,
        )  # fmt: skip
        self._map = (places, sizes, to, factor)
        self._lenses, self._shape = lenses, state.shape

        width = (free + 4) // 4 * 4
        shapes = ((free + 1, free + 1), (views, 6, 6), (views, 6, width))
        self._here: tuple[Float, ...] = _state_arrays(state, cameras)
        self._there = tuple(np.empty_like(part) for part in self._here)
        self._sums_here = tuple(np.zeros(shape) for shape in shapes)
        self._sums_there = tuple(np.zeros(shape) for shape in shapes)
        self._residuals_here, self._residuals_there = np.empty((2, data.shape[1])), np.empty((2, data.shape[1]))
        dz = np.zeros(width)
        dz[free] = 1.0
        self._work = (
            np.zeros(free), np.zeros((views, 6)), np.empty((views, 12, 6)), np.empty((views, 6, width)),
            np.empty((free + 1, width)), dz, np.empty((views + 1, 6)),
        )  # fmt: skip
        widest = bundle_kernels.WIDEST
        self._scratch = (
            np.zeros(bundle_kernels.LENGTH), np.empty((widest, widest)), np.empty((widest + 6, widest + 6)),
            np.empty((widest, 12)), np.eye(6, 12, 6), np.empty((3, 4)),
        )  # fmt: skip
        if is_under_way(self._fill):
            self._compile_step()
            wait_for(self._fill)
        self.cost, self._gradient_norm = self._evaluate(self._here, self._sums_here, self._residuals_here)
        self._values_there = (np.inf, np.inf)

    def _compile_step(self) -> None:
        """Call the step's kernel while the sums are still 0: another process compiles what fills them."""
        self._eliminate()
        for D2 in self._work[:2]:
            D2.fill(0.0)

    def _evaluate(self, at: tuple[Float, ...], sums: tuple[Float, ...], residuals: Float) -> tuple[float, float]:
        values: tuple[float, float] = self._fill(*self._problem, *at, *sums, residuals, *self._scratch)
        return values

    def propose(self, mu: float) -> tuple[float, float, float] | None:
        """Solve (A + μD²) δ = −b and evaluate F at the end of δ."""
        promised, longest = self._step(*self._sums_here, mu, *self._work, *self._map, *self._here, *self._there)
        if longest == -1.0:
            return None
        self._values_there = self._evaluate(self._there, self._sums_there, self._residuals_there)
        return promised, longest, self._values_there[0]

    def accept(self) -> None:
        """Move on."""
        self._here, self._there = self._there, self._here
        self._sums_here, self._sums_there = self._sums_there, self._sums_here
        self._residuals_here, self._residuals_there = self._residuals_there, self._residuals_here
        self.cost, self._gradient_norm = self._values_there

    def gradient_norm(self) -> float:
        """Return the largest |b_i| / √(A_ii F)."""
        return self._gradient_norm

    @property
    def equations(self) -> NormalEquations:
        """The normal equations here, as views of what the kernels keep."""
        U, V, W = self._sums_here
        F = len(U) - 1
        return NormalEquations(
            self.cost, U[:F, :F], U[F, :F], V, W[:, :, F], W[:, :, :F].transpose(0, 2, 1), self._residuals_here.T,
            eliminate=self._eliminate,
        )  # fmt: skip

    def _eliminate(self) -> tuple[Float, Float, Float] | None:
        """Factors of the undamped equations, from a step that is not taken."""
        _, longest = self._step(*self._sums_here, 0.0, *self._work, *self._map, *self._here, *self._there)
        L, Z, S = self._work[2:5]
        F = len(S) - 1
        return None if longest == -1.0 else (L[:, 6:].transpose(0, 2, 1), Z[:, :, :F], S[:F, :F])

    def state(self) -> BundleState:
        """Return the state."""
        theta, rigs, views = self._here
        intrinsics = [row[: 5 + count] for row, count in zip(theta, self._lenses, strict=True)]
        R_rig, t_rig, R_views, t_views = (
            np.ascontiguousarray(part) for part in (rigs[:, :, :3], rigs[:, :, 3], views[:, :, :3], views[:, :, 3])
        )
        return BundleState(intrinsics, R_rig, t_rig, R_views, t_views, self._shape)


def _state_arrays(state: BundleState, cameras: int) -> tuple[Float, Float, Float]:
    """θ (C, 19), and the poses of cameras and views as [R | t], (…, 3, 4)."""
    theta = np.zeros((cameras, _THETA))
    for row, values in zip(theta, state.intrinsics, strict=True):
        row[: len(values)] = values
    rigs, views = np.empty((cameras, 3, 4)), np.empty((len(state.R_views), 3, 4))
    rigs[:, :, :3], rigs[:, :, 3] = state.R_rig, state.t_rig
    views[:, :, :3], views[:, :, 3] = state.R_views, state.t_views
    return theta, rigs, views


def _unknowns(G: Float, lenses: list[int], stride: int, last: int) -> tuple[np.ndarray, ...]:
    """Of each camera: rows of J (whole tiles of four), and of a block's unknowns places, number, `to` and `factor`."""
    cameras, free = len(lenses), G.shape[1]
    at, unknown = (part.tolist() for part in np.nonzero(G))
    widest = max(lenses) + 5
    columns = np.full((cameras, (widest + 10) // 4 * 4), last)
    columns[:, :6] = range(0, 6 * stride, stride)
    places, to = np.zeros((cameras, widest + 13), dtype=np.int64), np.full((cameras, widest + 13), -1)
    sizes, factor = np.zeros(cameras, dtype=np.int64), np.ones((cameras, widest + 13))
    start, rigs = 0, sum(lenses) + 5 * cameras
    for c, count in enumerate(lenses):
        i = begin = 6 if c == 0 else 12
        for row, f in zip(at, unknown, strict=True):
            if start <= row < start + 5 + count:
                places[c, i], to[c, i], factor[c, i] = row - start, f, G[row, f]
                columns[c, 6 + i - begin] = (6 + row - start) * stride
                i += 1
            elif c > 0 and row == rigs + 6 * (c - 1):
                to[c, 6:12] = range(f, f + 6)
        to[c, i], sizes[c] = free, i + 1
        start += 5 + count
    # tiles beyond the columns that any camera uses would be filled for nothing
    used = max(int(size) - (6 if c > 0 else 0) for c, size in enumerate(sizes))
    return columns[:, : (used + 3) // 4 * 4].copy(), places, sizes, to, factor
