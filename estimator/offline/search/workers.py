"""Fits that do not depend on each other, done side by side in processes of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from estimator.offline.fit.fixed_parameters import by_sampling
from estimator.offline.fit.normal import Normal
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.search.trial import Setting, fit_names, never
from hil_gateway.process.arrays import Array


@dataclass(frozen=True)
class FitJob:
    """A fit to be done: of the named effects, in a `setting` and from a fit of its own if it has them.

    The progress says `label`. It ends after `iterations` where there are so many, as in `fit_names`. One that is
    `judged` comes with what `by_sampling` asks of it.
    """

    label: str
    names: tuple[str, ...]
    setting: Setting | None = None
    warm: Fit | None = None
    iterations: int | None = None
    judged: bool = False


def fit_each(setting: Setting, warm: Fit, jobs: Sequence[FitJob], progress: Callable[[str], None]) -> list[Fit]:
    """Fit every job starting from `warm`, side by side where `setting` has workers, results in order."""
    return begin_each(setting, warm, jobs, progress)()


def begin_each(
    setting: Setting, warm: Fit, jobs: Sequence[FitJob], progress: Callable[[str], None]
) -> Callable[[], list[Fit]]:
    """The same, begun where `setting` has workers; what is returned waits for the results."""
    settings = [job.setting or setting for job in jobs]
    pool = setting.pool
    if pool is None or not jobs:
        return lambda: _in_turn(settings, warm, jobs, progress)
    sent = [
        pool.submit(_numbers, replace(own, pool=None, over=never), replace(job, setting=None, warm=job.warm or warm))
        for own, job in zip(settings, jobs, strict=True)
    ]

    def results() -> list[Fit]:
        fits = []
        for own, job, future in zip(settings, jobs, sent, strict=True):
            progress(job.label)
            fits.append(Fit(Predictor(own.model(job.names), own.record), *future.result()))
        pool.forget_old()
        return fits

    return results


def _in_turn(
    settings: Sequence[Setting], warm: Fit, jobs: Sequence[FitJob], progress: Callable[[str], None]
) -> list[Fit]:
    done = []
    for own, job in zip(settings, jobs, strict=True):
        progress(job.label)
        done.append(fit_names(own, job.names, job.warm or warm, job.iterations))
    return done


def _numbers(setting: Setting, job: FitJob) -> tuple[Array, Normal, ResidualNoise, Array | None]:
    """What a fit found, without the record it was found on."""
    done = fit_names(setting, job.names, job.warm, job.iterations)
    done.held_out()  # asked for next, and kept
    return done.parameters, done.normal, done.noise, by_sampling(done) if job.judged else None
