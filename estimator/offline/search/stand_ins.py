"""Effects that explain less of what an accelerometer or the gyroscope shows than is left unexplained there.

They may only stand in for what leaves that, and are no finding. Not of a car that shows what every car has: the rest
of that is no stand-in.
"""

from __future__ import annotations

from collections.abc import Callable

from estimator.model.declared_vehicle import DECLARED
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.search.acceptance import explains_more_than_is_left, leaves_more_than_noise
from estimator.offline.search.every_car import expected_by_others
from estimator.offline.search.greedy import Checked, check_each
from estimator.offline.search.trial import Setting, fit_names


def without_stand_ins(
    setting: Setting, checked: Checked, fit: Fit, progress: Callable[[str], None]
) -> tuple[Checked, Fit]:
    """What is left of the effects of a fit, each put to the test again."""
    kept = no_stand_ins(setting, checked, fit)
    if len(kept) == len(checked.gains):
        return checked, fit
    fit = fit_names(setting, kept, fit)
    return check_each(setting, kept, fit, progress), fit


def no_stand_ins(setting: Setting, checked: Checked, fit: Fit) -> list[str]:
    """Names of the effects of a fit that stand in for nothing."""
    names = tuple(checked.gains)
    if not leaves_more_than_noise(fit):
        return [*names]
    sure = {*setting.found_road, *DECLARED, *expected_by_others(names)}
    without, gains = checked.without, checked.gains
    return [n for n in names if n in sure or explains_more_than_is_left(n, gains[n].channel, without[n], fit)]
