"""Robust losses: how much a large residual counts.

Least squares gives a corner that is ten times as far off a hundred times the say. With a robust loss the cost of a
point with squared residual e = ‖d‖² is not e but ρ(e), which grows more slowly from the scale σ on:

=========  ===================================  =========================  ==================================
loss       ρ(e)                                 weight w = ρ′(e)           when
=========  ===================================  =========================  ==================================
linear     e                                    1                          errors are normal
huber      e; 2σ√e − σ² beyond e = σ²           1; σ/√e beyond             some outliers; stays convex
cauchy     σ² ln(1 + e/σ²)                      1 / (1 + e/σ²)             gross outliers; they hardly count
=========  ===================================  =========================  ==================================

The minimum of Σρ is found by least squares with each point weighted by w, renewed in every iteration.

**How sure that minimum is.** What pulls at the unknowns is not d but ψ = w d, and what holds them is not w but the
derivative of ψ, which along and across d is w + 2ρ″e and w, on average over both h = w + ρ″e. With the weighted normal
matrix A_w in place of h̄ A, the covariance of the unknowns is

    σ²_ψ A_w⁻¹,        σ²_ψ = Σ w² e / freedom · w̄ / h̄²,

which is Σ e / freedom, the variance of a residual component, where nothing is forgiven. Gross outliers hardly enter.

Source: Triggs et al., *Bundle adjustment: a modern synthesis* (2000), section 3.3; Huber, *Robust Statistics* (1981),
section 7.6.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float

LOSSES = ("linear", "huber", "cauchy")
"""Names of the losses."""


def loss_and_weight(e: Float, loss: str, scale: float) -> tuple[Float, Float]:
    """Return ρ(e) and w = ρ′(e).

    Parameters
    ----------
    e : ndarray of shape (N,)
        Squared residuals.
    loss : {"linear", "huber", "cauchy"}
        Which.
    scale : float
        σ, in the units of the residuals: where the loss begins to forgive.

    Returns
    -------
    rho, weight : ndarray of shape (N,)
    """
    if loss == "linear":
        return e, np.ones_like(e)
    if loss == "huber":
        root = np.sqrt(np.maximum(e, scale**2))
        return np.where(e <= scale**2, e, 2 * scale * root - scale**2), scale / root
    return scale**2 * np.log1p(e / scale**2), 1 / (1 + e / scale**2)


def robust_variance(e: Float, loss: str, scale: float, freedom: float) -> float:
    """Return σ²_ψ, the factor of A_w⁻¹ in the covariance of the unknowns.

    Parameters
    ----------
    e : ndarray of shape (N,)
        Squared residuals.
    loss : {"linear", "huber", "cauchy"}
        Which.
    scale : float
        σ, in the units of the residuals.
    freedom : float
        Residual components minus unknowns.

    Returns
    -------
    float
    """
    weight = loss_and_weight(e, loss, scale)[1]
    if loss == "huber":
        bend = np.where(e <= scale**2, 0.0, -0.5 * weight)  # ρ″ e
    else:
        bend = -(weight**2) * e / scale**2 if loss == "cauchy" else np.zeros_like(e)
    held = float(np.mean(weight + bend))
    return float(np.sum(weight**2 * e)) / freedom * float(np.mean(weight)) / held**2
