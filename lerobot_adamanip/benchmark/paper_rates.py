"""Success rates reported in the paper: Wang et al., AdaManip, ICLR 2025. Data only."""

from __future__ import annotations

from collections.abc import Collection

PAPER_CATEGORIES = (
    "bottle", "pen", "pressure_cooker", "coffee_maker", "safe", "microwave", "window", "door", "lamp",
)  # fmt: skip
"""In the order of the paper's tables."""
SUCCESS: dict[str, tuple[tuple[float, float], ...]] = {
    "VAT-Mart": (
        (41.43, 17.44), (45.00, 12.04), (38.33, 18.33), (71.43, 14.29), (1.25, 0.88), (6.00, 5.10), (13.75, 6.73),
        (15.00, 12.24), (34.29, 19.38),
    ),
    "AdaAfford": (
        (42.86, 14.29), (70.00, 11.83), (55.00, 15.00), (61.43, 22.18), (21.25, 16.31), (77.00, 17.35), (45.00, 17.85),
        (21.25, 11.25), (52.86, 18.13),
    ),
    "Sampling": (
        (17.37, 9.72), (24.00, 11.14), (26.67, 16.99), (38.57, 16.96), (15.71, 11.87), (25.00, 10.25), (18.57, 12.86),
        (11.25, 8.75), (28.75, 13.75),
    ),
    "ACT": (
        (75.79, 8.55), (74.00, 16.85), (81.11, 5.49), (90.48, 6.73), (28.57, 15.43), (59.00, 14.46), (66.67, 5.39),
        (52.50, 14.58), (51.19, 13.62),
    ),
    "DP3": (
        (83.16, 12.19), (83.00, 11.87), (86.67, 4.08), (85.71, 10.10), (35.71, 21.02), (62.00, 13.27), (70.95, 3.37),
        (58.75, 14.84), (53.57, 13.20),
    ),
    "Ours w/o adaptive": (
        (87.14, 14.91), (80.00, 10.00), (85.00, 8.90), (91.42, 11.42), (38.75, 20.50), (58.00, 38.16), (74.77, 2.81),
        (56.25, 13.98), (54.29, 20.00),
    ),
    "Ours": (
        (95.07, 9.70), (99.05, 0.81), (98.33, 4.99), (97.14, 5.71), (61.25, 33.28), (100.00, 0.00), (94.33, 2.38),
        (88.75, 10.38), (82.53, 14.72),
    ),
}  # fmt: skip
"""Method -> (success, deviation) [%] per category, in the order of `PAPER_CATEGORIES`. From the table "Success Rates of
Different Methods". The paper does not say what the deviations measure, nor in which scenes."""
PAPER_OBJECTS = "seen"
"""Split of objects to compare the paper's rates with: the released code tests on its training objects."""


def reported(method: str | None, category: str) -> tuple[float, float] | None:
    """Returns success and deviation [%] of a method, by its name in the paper; None if the paper does not have it."""
    if method not in SUCCESS or category not in PAPER_CATEGORIES:
        return None
    return SUCCESS[method][PAPER_CATEGORIES.index(category)]


def reported_mean(method: str | None, categories: Collection[str]) -> float | None:
    """Returns a method's mean success over some categories [%]; None if the paper does not have the method."""
    values = [value for category in categories if (value := reported(method, category)) is not None]
    return sum(success for success, _ in values) / len(values) if values else None
