"""Fits that do not depend on each other, done side by side in processes of their own."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context

from estimator.offline.fit.normal import Normal
from estimator.offline.fit.prediction_error import Fit
from estimator.offline.predict.predict import Predictor
from estimator.offline.record.noise import Noise
from estimator.offline.search.trial import Setting, fit_names
from hil_gateway.process.arrays import Array

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""names of <malloc.h>"""
KEPT_BYTES, LARGEST_BYTES = 1 << 30, 32 << 20


@dataclass(frozen=True)
class Job:
    """A fit to be done: of the named effects, in a `setting` and from a fit of its own if it has them.

    The progress says `label`. It ends after `iterations` where there are so many, as in `fit_names`.
    """

    label: str
    names: tuple[str, ...]
    setting: Setting | None = None
    warm: Fit | None = None
    iterations: int | None = None


@contextmanager
def workers(count: int) -> Iterator[Executor | None]:
    """Processes for `fit_each`; none for a count of 1."""
    keep_freed_memory()
    if count <= 1:
        yield None
        return
    # a fork would copy locks of the threads that draw the progress or run BLAS
    with ProcessPoolExecutor(count, get_context("spawn"), initializer=keep_freed_memory) as pool:
        yield pool


def keep_freed_memory() -> None:
    """Have the C library keep what is freed: arrays of megabytes come and go, and fetching their pages anew from the
    kernel each time took a sixth of all time. Other C libraries than GNU's have no such setting."""
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
        library.mallopt(M_MMAP_THRESHOLD, LARGEST_BYTES)


def fit_each(setting: Setting, warm: Fit, jobs: Sequence[Job], progress: Callable[[str], None]) -> list[Fit]:
    """Fit every job starting from `warm`, side by side where `setting` has workers, results in order."""
    settings = [job.setting or setting for job in jobs]
    if setting.pool is None or len(jobs) < 2:
        done = []
        for own, job in zip(settings, jobs, strict=True):
            progress(job.label)
            done.append(fit_names(own, job.names, job.warm or warm, job.iterations))
        return done
    sent = [
        setting.pool.submit(_numbers, replace(own, pool=None), job.names, job.warm or warm, job.iterations)
        for own, job in zip(settings, jobs, strict=True)
    ]
    fits = []
    for own, job, future in zip(settings, jobs, sent, strict=True):
        progress(job.label)
        parameters, normal, noise = future.result()
        fits.append(Fit(Predictor(own.model(job.names), own.record), parameters, normal, noise))
    return fits


def _numbers(setting: Setting, names: Sequence[str], warm: Fit, iterations: int | None) -> tuple[Array, Normal, Noise]:
    """What a fit found, without the record it was found on."""
    done = fit_names(setting, names, warm, iterations)
    done.held_out()  # asked for next, and kept
    return done.parameters, done.normal, done.noise
