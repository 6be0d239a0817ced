"""A chattering command is what the car was told; the scatter of a measured slip is not."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfilt

from estimator.offline.record.reported_inputs import without_noise

STEP, GAIN = 0.01, 60.0


def drive_and_chatter() -> tuple[np.ndarray, np.ndarray]:
    """A pedal that moves below 1 Hz or so, and what is faster."""
    rng = np.random.default_rng(3)
    low = butter(2, 1.0, fs=1.0 / STEP, output="sos")
    slow = 0.15 * sosfilt(low, rng.standard_normal(12_000))
    return slow, 0.002 * rng.standard_normal(len(slow))


def test_chatter_that_the_acceleration_follows_is_kept() -> None:
    slow, chatter = drive_and_chatter()
    response = GAIN * (slow + chatter) + 0.15 * np.random.default_rng(4).standard_normal(len(slow))
    assert np.array_equal(without_noise(slow + chatter, response, STEP), slow + chatter)


def test_scatter_that_the_acceleration_does_not_know_is_smoothed() -> None:
    slow, scatter = drive_and_chatter()
    response = GAIN * slow + 0.15 * np.random.default_rng(4).standard_normal(len(slow))
    cleaned = without_noise(slow + scatter, response, STEP)
    assert np.std(cleaned - slow) < 0.5 * np.std(scatter)


def test_an_input_without_noise_is_left_alone() -> None:
    slow, _ = drive_and_chatter()
    assert without_noise(slow, GAIN * slow, STEP) is slow


def test_a_command_is_kept_where_the_acceleration_is_all_noise() -> None:
    slow, chatter = drive_and_chatter()
    command = 0.02 * slow + chatter
    noise = 0.5 * np.random.default_rng(4).standard_normal(len(slow))
    assert np.array_equal(without_noise(command, GAIN * command + noise, STEP), command)
