"""The library's values are as near to the references as they have been, by stored bounds."""

import pytest

from references.comparison import found_errors, table

BOUNDS = {key: float(row["bound"]) for key, row in table("errors.csv").items()}
VALUES = table("values.csv")
POOR = 1e-12
DIFFERENCE = (
    "what is nonlinear in a covariance is a difference of means of the size of the function"
)
WEAK = {
    ("Kalman filter", "wide_prior"): "the second forecast is nearly singular, of condition 1e8, "
    "and a covariance does not keep its small direction",
    ("smoother", "small"): "the smoothed variance is a small part of the filtered one, which it is "
    "taken from",
    ("covariance", "quiet"): DIFFERENCE,
    ("covariance", "small"): DIFFERENCE,
    ("covariance", "smaller"): DIFFERENCE,
    ("nonlinear filters", "exact quiet"): DIFFERENCE,
    ("nonlinear filters", "extended quiet"): "the first variances fall by a factor of 1e6",
    ("nonlinear filters", "unscented quiet"): "the first variances fall by a factor of 1e6",
}
"""Cases in which more is lost than the condition number explains, and what loses it."""


@pytest.mark.parametrize("family", sorted({family for family, _, _ in VALUES}))
def test_values_are_as_accurate_as_stored(family):
    found = found_errors({family})
    assert set(found) == {key for key in VALUES if key[0] == family}
    worse = [
        f"{' / '.join(key)}: error {error:.2g}, bound {BOUNDS[key]:.2g}"
        for key, error in found.items()
        if not error <= BOUNDS[key]
    ]
    assert not worse, "\n".join(worse)


def test_every_value_has_its_bound_and_every_large_one_its_reason():
    """A bound above 1e-12 is a matter of the problem, by its condition, or told to be weak."""
    assert list(BOUNDS) == list(VALUES)
    unexplained = {
        key[:2]
        for key, bound in BOUNDS.items()
        if bound > POOR and bound > float(VALUES[key]["condition"] or 0) * 2.0**-48
    }
    assert unexplained == set(WEAK)
