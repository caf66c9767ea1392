"""Statistics (scipy's), and numbers as the tables show them."""

import warnings
from typing import NamedTuple

import numpy as np
from scipy import stats


class Difference(NamedTuple):
    """Of means: its estimate, half the width of its 95% interval, and p."""

    gain: float
    margin: float
    p: float

    def __str__(self):
        return f"{number(self.gain)} ({self.interval()})"

    def interval(self):
        return " to ".join(number(self.gain + sign * self.margin) for sign in (-1, 1))


def difference(test):
    """The result of one of scipy's t-tests."""
    low, high = test.confidence_interval()
    return Difference((low + high) / 2, (high - low) / 2, test.pvalue)


def welch(changed, usual):
    """The mean of the first minus that of the second."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # where all of one are equal
        return difference(stats.ttest_ind(changed, usual, equal_var=False))


def paired(gains):
    """The mean of gains, each of a pair."""
    return difference(stats.ttest_1samp(gains, 0))


def of_one_more(values):
    """The 95% interval of one more value of the same normal distribution."""
    count = len(values)
    scale = np.std(values, ddof=1) * (1 + 1 / count) ** 0.5
    return stats.t.interval(0.95, count - 1, np.mean(values), scale)


def holm(p_values, level=0.05):
    """Which p-values stay below the level when corrected for their number (Holm 1979)."""
    passes = np.sort(p_values) <= level / np.arange(len(p_values), 0, -1)
    return np.logical_and.accumulate(passes)[np.argsort(np.argsort(p_values))]


def number(value, digits=0):
    return f"{round(value, digits) + 0.0:,.{digits}f}".replace("-", "−")  # + 0.0: no "−0"


def spread(values, digits=0):
    """Mean ± standard deviation (n − 1)."""
    return f"{number(np.mean(values), digits)} ± {number(np.std(values, ddof=1), digits)}"


def median(values, digits=0):
    """With its 95% interval, of the bootstrap."""
    resampled = stats.bootstrap((values,), np.median, method="percentile", random_state=0)
    low, high = (number(end, digits) for end in resampled.confidence_interval)
    return f"{number(np.median(values), digits)} ({low} to {high})"


def proportion(passed):
    """How many of how many, and the exact 95% interval of the probability."""
    low, high = stats.binomtest(int(sum(passed)), len(passed)).proportion_ci()
    return f"{sum(passed)} of {len(passed)} ({100 * low:.3g}% to {100 * high:.3g}%)"


def p_text(p):
    return "< 0.001" if p < 0.001 else f"{p:.2g}"


def marked(p_values):
    """Bold where it holds after Holm's correction; empty where it is unknown."""
    known = [p for p in p_values if p == p]
    holds = dict(zip(known, holm(known)))
    return ["" if p != p else f"**{p_text(p)}**" if holds[p] else p_text(p) for p in p_values]
