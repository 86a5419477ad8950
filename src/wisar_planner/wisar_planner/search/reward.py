"""The paper's reward for one step and its shaped form."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from wisar_planner.errors import FloatArray
from wisar_planner.search.problem import SearchProblem


def scaled_reward(problem: SearchProblem, gains: npt.ArrayLike) -> FloatArray:
    r"""Return the reward :math:`r = k \, \Delta p_t / p_A` of steps.

    :math:`k` is the search area over the area of one isolated step,
    :math:`R (\pi R + 2 \lambda)`, so that a step over a map of constant density earns 1.

    Parameters
    ----------
    problem : SearchProblem
        Supplies the area, the swath radius R, the step length lambda and p_A.
    gains : (N,) array_like
        Probability newly seen by each step, :math:`\Delta p_t`.

    Returns
    -------
    (N,) float64
    """
    radius = problem.swath_radius
    k = problem.area.area / (radius * (math.pi * radius + 2.0 * problem.step_length))
    return np.asarray(gains, dtype=np.float64) * (k / problem.probability_in_area)


def shaped_reward(
    problem: SearchProblem,
    gains: npt.ArrayLike,
    positions: npt.ArrayLike,
    *,
    epsilon: float = 0.1,
    w_oob: float = 1.0,
    w_r: float = 0.5,
    w_0: float = 0.5,
) -> FloatArray:
    r"""Return the paper's shaped reward :math:`r'` of steps.

    It is :math:`-w_{oob}` where the step ends outside the area, :math:`w_r r` where it earns
    something, and :math:`-w_0` otherwise. The paper compares epsilon with the probability gained;
    at its parameters no step could ever pass 0.1, so here epsilon is compared with the scaled
    reward :math:`r`.

    Parameters
    ----------
    problem : SearchProblem
        The search problem.
    gains : (N,) array_like
        Probability newly seen by each step.
    positions : (N, 2) array_like
        Where each step ends, m.
    epsilon, w_oob, w_r, w_0 : float
        Threshold and weights; defaults are the paper's.

    Returns
    -------
    (N,) float64
    """
    reward = scaled_reward(problem, gains)
    earned = np.where(reward > epsilon, w_r * reward, -w_0)
    return np.where(problem.area.contains(positions), earned, -w_oob)
