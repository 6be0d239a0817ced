"""What all processes that drive one car have to agree on: track and car, each by its name and what its files say."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from hil_gateway.bus.messages import Agreement
from hil_gateway.config import Config
from hil_gateway.track.track import Track

NAME_LENGTH = 40


def agreement(config: Config, track: Track) -> Agreement:
    """Of a process with this configuration, on this track."""
    return Agreement(track=_signed(track.name, _course(track)), car=_signed(Path(config.platform).name, _car(config)))


def disagreement(ours: Agreement, sender: str, theirs: Agreement | None) -> str:
    """What a sender drives by otherwise than we do, in words; empty where nothing is known, or nothing differs."""
    if theirs is None or (theirs.track == ours.track and theirs.car == ours.car):
        return ""
    pairs = ((name, getattr(theirs, name), own) for name, own in ours)
    return "; ".join(f"{sender}: {name} {other}, here {own}" for name, other, own in pairs if other != own)


def _signed(name: str, content: bytes) -> str:
    return f"{name[:NAME_LENGTH]} {hashlib.sha256(content).hexdigest()[:8]}"


def _course(track: Track) -> bytes:
    """In centimetres and milliradians: processors differ in the last digits of a spline."""
    values = [track.x, track.y, track.width_left, track.width_right, track.z, 10.0 * track.bank]
    if (lane := track.pit_lane) is not None:
        values += [lane.s, lane.left, lane.right, np.array([lane.speed, *lane.limit]), np.ravel(lane.boxes)]
    return np.round(np.concatenate(values) * 100.0).astype(np.int64).tobytes()


def _car(config: Config) -> bytes:
    """The folder, and what the configuration says otherwise."""
    return (
        config.car.sha256.encode()
        + config.vehicle.model_dump_json().encode()
        + config.powertrain.model_dump_json().encode()
    )
