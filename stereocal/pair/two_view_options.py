"""How F and E are fitted: the options that both share, checked once.

============  =======================================================================================
`method`      who is believed: all matches (``8point``, ``5point``), or the consensus of many
              (``lmeds``, ``ransac``); see ``consensus``
`threshold`   the largest distance of an inlier for ``ransac``, pixels. It steers the search only
`confidence`  of having drawn a sample without outliers
`iterations`  limit on samples
`seed`        of the random draws: the same seed gives the same answer
`refine`      whether to end at the maximum-likelihood answer (``two_view_refinement``); by default all
              but the linear ``8point`` do
`backend`     the compiled kernels (``numba``) or their readable twins (``numpy``)
============  =======================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from stereocal.base.checks import require_choice, require_integer, require_positive
from stereocal.base.errors import InputError

BACKENDS = ("numba", "numpy")


@dataclass(frozen=True)
class TwoViewOptions:
    """Options of a fit, as in the module's table.

    Attributes
    ----------
    method : str
    threshold : float or None
        None: the fit's own, which :meth:`checked` puts in.
    confidence : float
    max_iterations : int
    seed : int
    refine : bool or None
    backend : str
    """

    method: str = "8point"
    threshold: float | None = None
    confidence: float = 0.999
    max_iterations: int = 10_000
    seed: int = 0
    refine: bool | None = None
    backend: str = "numba"

    def checked(self, methods: tuple[str, ...], threshold: float) -> TwoViewOptions:
        """Return these options, or refuse them.

        Parameters
        ----------
        methods : tuple of str
            Those that the fit has.
        threshold : float
            The one to take if none is given.

        Returns
        -------
        TwoViewOptions

        Raises
        ------
        InputError
            Which says which option is wrong and what it may be.
        """
        require_choice(self.method, methods, "method")
        require_choice(self.backend, BACKENDS, "backend")
        reach = require_positive(threshold if self.threshold is None else self.threshold, "threshold")
        require_integer(self.max_iterations, "max_iterations", minimum=1)
        if not 0 < self.confidence < 1:
            raise InputError(f"confidence must be between 0 and 1, but is {self.confidence:g}")
        return replace(self, threshold=reach)

    @property
    def reach(self) -> float:
        """The threshold of checked options."""
        return float(self.threshold or 0.0)

    @property
    def score(self) -> str:
        """What consensus takes for best: ``lmeds`` or ``msac``."""
        return "lmeds" if self.method == "lmeds" else "msac"

    @property
    def refines(self) -> bool:
        """Whether the fit ends with the refinement."""
        return self.method != "8point" if self.refine is None else bool(self.refine)
