"""A stop answers whatever motion and pose it is given: they may be of different moments after a pause."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from hil_gateway.car.car import load_car
from hil_gateway.gateway.act.stopping import Stopping
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.motion import UNDERSTEER_MOST, Motion
from hil_gateway.observer.axles import Axle, Axles
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.settings.gateway import StopConfig
from hil_gateway.track.loading import load_track

TRACK = load_track("oval")
SPEED = st.one_of(st.just(0.0), st.floats(0.0, 100.0))
SIGNED = st.floats(-10.0, 10.0)
MOTION = st.builds(
    Motion,
    speed=SPEED,
    yaw_rate=SIGNED,
    ay=st.floats(-60.0, 60.0),
    by_gyro=st.booleans(),
    understeer=st.floats(0.0, UNDERSTEER_MOST),
    late_s=st.sampled_from([0.0, 0.1, math.inf]),
    by_wheels=st.booleans(),
    slip=SIGNED,
)
POSE = st.builds(
    Pose, st.floats(-500.0, 500.0), st.floats(-500.0, 500.0), SIGNED, SPEED, st.one_of(st.just(0.0), SIGNED)
)
AXLE = st.builds(Axle, st.floats(0.5, 80.0), st.floats(0.02, 0.3), st.floats(-20.0, 20.0))
SMALL = st.floats(-1.0, 1.0)
AXLES = st.builds(
    Axles,
    st.just(load_car().vehicle),
    AXLE,
    AXLE,
    st.floats(SLOWEST, 100.0),
    st.floats(-80.0, 80.0),
    SIGNED,
    SMALL,
    SMALL,
)
KNOWN = st.tuples(MOTION, st.none() | POSE, st.none() | AXLES, *[st.booleans()] * 4)


@given(motions=st.lists(KNOWN, min_size=1, max_size=4))
def test_a_stop_answers_every_motion_and_pose(motions) -> None:
    stop = Stopping(load_car(), StopConfig(), TRACK)
    stop.start(0.01)
    for motion, pose, axles, emergency, steers, brakes, flat in motions:
        stop.flat = flat
        ahead = axles and axles.onward([0.1] * 12)
        steer, drive = stop.command(motion, pose, emergency, ahead, steers=steers, brakes=brakes)
        assert math.isfinite(steer)
        assert math.isfinite(drive) and drive <= 0.0
