"""Two curves for the same data: which one the data prefer, and by how much.

Sources: Burnham & Anderson, Model Selection and Multimodel Inference, 2nd ed. 2002, sections 2.2 and 2.4 (AIC, AICc);
Schwarz 1978 (BIC).
"""

from dataclasses import dataclass

import numpy as np

from camcal.estimate.curves.result import CurveFit

_EVEN = 2.0  # a difference of AICc that says nothing (Burnham & Anderson 2002, section 2.6)


@dataclass(frozen=True)
class Criteria:
    """Information criteria of a fit, lower is better; aicc is None where there are too few data for it."""

    aic: float
    aicc: float | None
    bic: float


@dataclass(frozen=True)
class Comparison:
    """The first fit beside the second.

    preferred: which of the two has the lower AICc by more than 2 (AIC where there is none), or 'neither'.
    f, p_value: the F test of the larger against the smaller one, which must be a special case of it; None where the
    two have as many parameters or the larger one fits worse.
    """

    first: Criteria
    second: Criteria
    preferred: str
    f: float | None
    p_value: float | None


def criteria(fit: CurveFit) -> Criteria:
    """Return the information criteria of a least-squares fit with normal errors."""
    good = fit.goodness
    count = good.rows * fit.curve.freedom
    parameters = count - good.freedom
    if good.chi_square is not None:
        surprise = good.chi_square
    else:
        surprise = count * float(np.log(max(good.sum_of_squares, np.finfo(float).tiny) / count))
        parameters += 1  # the noise is estimated too
    aic = surprise + 2 * parameters
    spare = count - parameters - 1
    aicc = aic + 2 * parameters * (parameters + 1) / spare if spare > 0 else None
    return Criteria(aic, aicc, surprise + parameters * float(np.log(count)))


def compare(first: CurveFit, second: CurveFit) -> Comparison:
    """Return how two least-squares fits to the same data compare."""
    of_first, of_second = criteria(first), criteria(second)
    if of_first.aicc is not None and of_second.aicc is not None:
        lead = of_second.aicc - of_first.aicc
    else:
        lead = of_second.aic - of_first.aic
    preferred = "neither" if abs(lead) <= _EVEN else "first" if lead > 0 else "second"
    return Comparison(of_first, of_second, preferred, *_f_test(first, second))


def _f_test(first: CurveFit, second: CurveFit) -> tuple[float | None, float | None]:
    from scipy.special import fdtrc

    smaller, larger = sorted((first, second), key=lambda fit: -fit.goodness.freedom)
    extra = smaller.goodness.freedom - larger.goodness.freedom
    gain = smaller.goodness.sum_of_squares - larger.goodness.sum_of_squares
    if extra == 0 or larger.goodness.freedom <= 0 or gain < 0 or larger.goodness.sum_of_squares == 0:
        return None, None
    value = gain / extra / (larger.goodness.sum_of_squares / larger.goodness.freedom)
    return value, float(fdtrc(extra, larger.goodness.freedom, value))
