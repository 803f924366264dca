"""Numbers to compare with: what the paper prints, and what an independent full-order code found. Nothing measured here.

Paper: F. Naets, T. Tamarozzi, W. Desmet, Procedia IUTAM 13 (2015) 4-13. Where it has pictures only, the numbers are
those written along the axes and the curves' ends and peaks as one reads them.

Reference: an explicit Runge-Kutta code on the constraint-eliminated equations of the same beams (5 elements a body,
torque 0.5 Nm x min(t / 0.25 s, 1)), checked against a second code; frequencies and the trajectory are converged to 8
digits or more, the distributions are those of 10 000 samples. It shares no code with this program.
"""

from __future__ import annotations

from dataclasses import dataclass

RADII = {"0.9": 5.04e-3, "1.0": 5.6e-3, "1.1": 6.16e-3}  # m: the crank's, by its share of the nominal one
NOMINAL = "1.0"


@dataclass(frozen=True)
class Band:
    """A frequency over a revolution (Fig. 2).

    Attributes
    ----------
    name
        As in the paper, which counts the rigid motion as the first mode.
    mode
        Number of the flexible mode, from 0.
    labels
        First and last number along the paper's axis and their spacing, Hz.
    reference
        Lowest and highest frequency of the reference by radius, Hz.
    """

    name: str
    mode: int
    labels: tuple[float, float, float]
    reference: dict[str, tuple[float, float]]


BANDS = (
    Band("f2", 0, (50.0, 60.0, 10.0), {"1.0": (49.0, 64.1)}),
    Band("f3", 1, (232.0, 242.0, 2.0), {"1.0": (229.2, 238.9)}),
    Band("f4", 2, (250.0, 350.0, 50.0), {"0.9": (248, 327), "1.0": (277, 357), "1.1": (306, 392)}),
    Band("f5", 3, (700.0, 750.0, 50.0), {"1.0": (694.4, 750.4)}),
)

# Fig. 4: largest error of the reduced model, % of the largest value
LARGEST_ERROR_PERCENT = {"crank_angle": 0.03, "slider_deformation": 8.0}

# Fig. 5
RADIUS_MEAN, RADIUS_STD = 5.6e-3, 0.56e-3  # m; the paper prints 0.56 m, a misprint
RADIUS_SUPPORT, RADIUS_PEAK = (4e-3, 7e-3), 700.0  # m along the axis; 1/m


@dataclass(frozen=True)
class Density:
    """Distribution of an output at 1 s (Fig. 6).

    Attributes
    ----------
    support, peak
        As read from the paper's picture.
    mean, std, reference_peak
        Of the reference's 10 000 samples.
    """

    support: tuple[float, float]
    peak: float
    mean: float
    std: float
    reference_peak: float


DENSITIES = {
    "crank_angle": Density((4.8, 5.8), 2.5, 5.283, 0.167, 2.40),
    "slider_deformation": Density((-3e-4, -0.5e-4), 15000.0, -0.928e-4, 0.288e-4, 14833.0),
}
REFERENCE_SAMPLES = 10_000

# Section 6: Monte Carlo in Matlab, 10 000 samples, "around a week" and "merely two hours"
PAPER_COST_HOURS = {"full": 7 * 24.0, "reduced": 2.0}

# The reference's frequencies (Hz) at two angles (rad), nominal radius
FREQUENCIES_HZ = {
    0.0: (64.0669736526, 238.871521006, 356.890061625, 750.444260939, 1299.71476299, 1373.69562087),
    1.5707963267948966: (52.4629361603, 229.164262909, 278.2741278, 699.848741912, 1247.10614961, 2109.54195867),
}

# The reference's outputs at 1 s, nominal radius (rad, m, m)
AT_THE_END = {
    "crank_angle": 5.28277488032,
    "slider_position": 0.814768388572,
    "slider_deformation": -8.91202658466e-05,
}
