"""When a model found in the background may be driven with, and when it has to go again.

Open-loop prediction over one second on a lap that nothing was learnt from decides, because a planner drives by such
predictions. The rival is the model in force with everything re-fitted to the same laps: what a re-fit does alone is
no merit of an effect. The model driven with at the moment counts too, so that adopting never makes a prediction worse.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from estimator.belief.relinearised import TINY

Errors = Mapping[str, float]
"""channel -> RMS error after one second, SI"""

NO_WORSE = 1.03
"""no channel may get worse by more: that much the errors of one unchanged model differ from lap to lap, while models
that diverged on the road were worse by 30 % and more"""
WORTH = 0.97
"""geometric mean of the channels' ratios that is worth new functions of the planner: as much again"""
IDLE = 1.01
"""an effect without which that mean is no worse than this predicts nothing"""
SLOWER = 1.02
"""a lap longer by this factor than the last one before the adoption: laps of one model differ by 1 %"""


def why_not(refit: Errors, in_force: Errors, found: Errors) -> str:
    """Why the model found is not to be driven with, by errors on the held-out lap; empty when it is."""
    for rival, errors in (("the re-fitted model", refit), ("the model in force", in_force)):
        if worse := _worst(errors, found):
            return f"{worse} than that of {rival} on the held-out lap"
    gain = mean_ratio(refit, found)
    if not gain <= WORTH:
        return f"prediction of the held-out lap is {gain:.3f} of the re-fitted model's: not worth a change"
    return ""


def regress(before: Errors, after: Errors, lap_before_s: float, lap_after_s: float) -> str:
    """Why a model that was adopted goes again, by the first whole lap driven with it; empty when it stays."""
    if worse := _worst(before, after):
        return f"{worse} than that of the model before on the first lap with it"
    if lap_after_s > SLOWER * lap_before_s:
        return f"the first lap with it took {lap_after_s:.1f} s, the last one before {lap_before_s:.1f} s"
    return ""


def _worst(rival: Errors, found: Errors) -> str:
    """The channel that gets worse by most, in words; empty where none does."""
    ratios = {name: found[name] / max(rival[name], TINY) for name in rival}
    if not all(math.isfinite(ratio) for ratio in ratios.values()):
        return "prediction diverges: worse"
    name = max(ratios, key=lambda channel: ratios[channel])
    return f"prediction of {name} is {ratios[name]:.2f} times worse" if ratios[name] > NO_WORSE else ""


def mean_ratio(before: Errors, after: Errors) -> float:
    """Geometric mean over the channels of the error after over that before."""
    logs = [math.log(max(after[name], TINY) / max(before[name], TINY)) for name in before]
    return math.exp(sum(logs) / len(logs))
