"""The compiled predictor against the numpy code that stands in for it, and against its absence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from support.drives.practice_drives import record_of, shared_drives

from estimator.offline.fit import normal
from estimator.offline.predict import compiled_windows, innovations, propagate
from estimator.offline.predict.compiled_windows import VECTOR, windows_library
from estimator.offline.predict.innovations import Innovations
from estimator.offline.predict.propagate import Propagator, exponentials
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.record.window_columns import WindowColumns
from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import find_compiler

BLOCKS, WINDOWS = 7, 2 * VECTOR + 3
VARIANCE, WALK = np.array([0.04, 0.05, 1e-4, 0.02, 1e12]), np.array([0.01, 0.0, 1e-5])
START = np.array([0.1, 0.2, 0.05])

needs_a_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler: there is nothing to compare")


@pytest.fixture
def motion() -> Propagator:
    """Unequal motion in every block and window."""
    state_by = np.random.default_rng(3).normal(scale=4.0, size=(5, 3, WINDOWS, BLOCKS))
    return Propagator.make(state_by, 0.04)


@needs_a_compiler
def test_compiled_exponentials_are_those_of_numpy() -> None:
    a = np.random.default_rng(1).normal(scale=0.5, size=(3, 3, BLOCKS, WINDOWS))
    doublings = propagate._doublings(a)
    for compiled, plain in zip(exponentials(a), propagate._exponentials(a / 2**doublings, doublings), strict=True):
        np.testing.assert_allclose(compiled, plain, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("size", [0.01, 1.0, 30.0, 2000.0])
def test_exponentials_are_right_however_stiff_the_motion_is(size: float) -> None:
    """A model car at walking pace decays thousands of times within a block, an AV-24 at speed hardly at all."""
    rng = np.random.default_rng(7)
    a = np.zeros((3, 3, 2, WINDOWS))
    for b, w in np.ndindex(2, WINDOWS):
        skew = rng.normal(size=(3, 3))
        a[:, :, b, w] = skew @ np.diag(-size * rng.uniform(0.0, 1.0, 3)) @ np.linalg.inv(skew)
    decay, first, _ = exponentials(a)
    for b, w in np.ndindex(2, WINDOWS):
        np.testing.assert_allclose(decay[:, :, b, w], expm(a[:, :, b, w]), atol=1e-6)
        np.testing.assert_allclose(a[:, :, b, w] @ first[:, :, b, w], expm(a[:, :, b, w]) - np.eye(3), atol=1e-6)


@needs_a_compiler
def test_compiled_gains_and_maps_are_those_of_numpy(motion: Propagator, monkeypatch: pytest.MonkeyPatch) -> None:
    gains, ratio = innovations.riccati(motion, VARIANCE, WALK, START)
    weight = np.random.default_rng(2).uniform(0.5, 2.0, size=ratio.shape)
    step = innovations.maps(motion, gains, weight)
    monkeypatch.setattr(innovations, "windows_library", lambda: None)
    plain_gains, plain_ratio = innovations.riccati(motion, VARIANCE, WALK, START)
    np.testing.assert_allclose(gains, plain_gains, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(ratio, plain_ratio, rtol=1e-9)
    np.testing.assert_allclose(step, innovations.maps(motion, gains, weight), rtol=1e-9, atol=1e-12)


@needs_a_compiler
def test_compiled_innovations_are_those_of_numpy(motion: Propagator, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    gains, ratio = innovations.riccati(motion, VARIANCE, WALK, START)
    predictor = Innovations(innovations.maps(motion, gains, 1.0 / np.sqrt(ratio)), np.ones(5))
    inputs, columns = rng.normal(size=(BLOCKS, WINDOWS, 11, 1)), rng.normal(size=(BLOCKS, WINDOWS, 5, VECTOR + 5))
    moved = np.array([-0.04, -0.04, 0.0])
    compiled_inputs = inputs.copy()
    compiled = predictor.run(compiled_inputs), predictor.run_columns(columns, moved)
    monkeypatch.setattr(innovations, "windows_library", lambda: None)
    np.testing.assert_allclose(compiled[0], predictor.run(inputs), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(compiled_inputs, inputs, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(compiled[1], predictor.run_columns(columns, moved), rtol=1e-9, atol=1e-9)


@needs_a_compiler
@pytest.mark.parametrize("used", [(True,) * 5, (True, False, True, True, False)], ids=["all", "no ay, no vy"])
def test_compiled_residuals_are_the_innovations_of_the_maps(
    motion: Propagator, used: tuple[bool, ...], tmp_path_factory: pytest.TempPathFactory
) -> None:
    whole = record_of(shared_drives(tmp_path_factory)["flat"])
    record = replace(whole, used=np.array(used))
    noise = ResidualNoise(2.0 * record.block_noise, np.array([0.0, 0.0, 0.3, 0.1, 2.0]))
    inputs = np.random.default_rng(5).normal(size=(BLOCKS, WINDOWS, 11, 1))
    found, scale = innovations.residuals(record, motion, noise, inputs)
    predictor = Innovations.make(record, motion, noise)
    expected = predictor.run(inputs.copy())[..., 0].transpose(2, 1, 0)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(scale, predictor.scale)


@needs_a_compiler
@pytest.mark.parametrize("count", [1, VECTOR - 1, VECTOR, 2 * VECTOR + 1])
def test_compiled_sums_are_those_of_numpy(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, size = np.random.default_rng(count), count + 4
    places: Array = np.array([rng.permutation(size)[:count] for _ in range(WINDOWS)])
    columns = WindowColumns(rng.normal(size=(BLOCKS, WINDOWS, 5, count)), places, size)
    error, lap = rng.normal(size=(5, WINDOWS, BLOCKS)), np.arange(WINDOWS) // 6
    compiled = normal.accumulate(error, columns, lap)
    monkeypatch.setattr(normal, "windows_library", lambda: None)
    for found, plain in zip(compiled, normal.accumulate(error, columns, lap), strict=True):
        np.testing.assert_allclose(found, plain, rtol=1e-10, atol=1e-12)


@needs_a_compiler
def test_compiled_arrangement_is_that_of_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    by = np.random.default_rng(6).normal(size=(3, 5, WINDOWS, BLOCKS))
    compiled, plain = np.zeros((2, BLOCKS, WINDOWS, 5, 4))
    compiled_windows.arrange(by, compiled)
    monkeypatch.setattr(compiled_windows, "windows_library", lambda: None)
    compiled_windows.arrange(by, plain)
    np.testing.assert_array_equal(compiled, plain)


def test_without_a_compiler_there_is_no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("estimator.model.library.find_compiler", lambda: None)
    assert windows_library.__wrapped__() is None
