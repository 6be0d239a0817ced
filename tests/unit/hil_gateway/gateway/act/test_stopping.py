"""Steering and braking without the planner."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.cars.scripted_car import Rig
from support.cars.turning_car import FRONT, REAR, TurningCar

from hil_gateway.bus.messages import FailsafeAction
from hil_gateway.car.car import load_car
from hil_gateway.gateway.act.stop_path import Path, polyline, way_along
from hil_gateway.gateway.act.stopping import Stopping
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.observer.axles import Axle, Axles
from hil_gateway.process.arrays import Array
from hil_gateway.settings.gateway import StopConfig
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

CAR = load_car()
VEHICLE = CAR.vehicle
HALF_WIDTH = VEHICLE.half_width
HERE = Pose(0.0, 0.0, 0.0, 40.0)


@pytest.fixture
def rig() -> Rig:
    made = Rig()
    made.run(0.2)
    return made


def stopping(track=None) -> Stopping:
    return Stopping(load_car(), StopConfig(), track)


def following(x: Array, y: Array) -> Stopping:
    """A stop that has taken this path."""
    stop = stopping()
    stop.start(0.0)
    stop._path = polyline(np.array([x, y]))
    return stop


STRAIGHT = np.linspace(0.0, 400.0, 801)


def motion(speed: float = 40.0, ay: float = 0.0) -> Motion:
    return Motion(speed=speed, ay=ay)


def test_points_ahead_lie_on_the_path_and_end_with_it():
    path = polyline(np.array([[0.0, 10.0, 10.0], [0.0, 0.0, 10.0]]))
    assert path.ahead(path.nearest(0.0, 1.0), 5.0) == (5.0, 0.0)
    assert path.ahead(path.nearest(9.0, 0.0), 5.0) == (10.0, 5.0)
    assert path.ahead(path.nearest(9.0, 9.0), 50.0) == (10.0, 10.0)


def test_a_stop_without_the_planner_brakes_with_the_declared_balance(rig):
    """Whatever balance was asked for before."""
    rig.drive = 0.1
    rig.drive_off(12.0)
    rig.drive, rig.brake_balance = -0.1, -0.1
    rig.run(0.2)
    assert front_share(rig) == pytest.approx(0.45, abs=0.002)
    rig.planner_runs = False
    rig.run(0.5)
    assert rig.action is not FailsafeAction.DRIVE
    assert front_share(rig) == pytest.approx(0.54, abs=0.002)


def front_share(rig: Rig) -> float:
    """Of the brake pressures on the wire."""
    front, rear = (rig.car.commands[f"{axle}_brake_pressure_cmd"] for axle in "FR")
    assert rig.car.speed > 5.0
    return front / (front + rear)


def test_a_flat_tyre_leaves_less_for_braking_beside_cornering():
    sound, flat = stopping(load_track("oval")), stopping(load_track("oval"))
    flat.flat = True
    here = beside(load_track("oval"), 10.0, 0.0, 0.0, 40.0)
    drives = [stop.command(motion(40.0, ay=12.0), here, True)[1] for stop in (sound, flat)]
    assert drives[0] < drives[1] < 0.0


def test_a_car_that_turns_faster_than_its_way_is_steered_against():
    track = load_track("oval")
    turning, here = Motion(speed=40.0, yaw_rate=0.4, ay=0.0), beside(track, 10.0, 0.0, 0.0, 40.0)
    answers, late = stopping(track), stopping(track)
    unanswered = late.command(turning._replace(late_s=math.inf), here, False)[0]
    assert answers.command(turning, here, False)[0] < unanswered - 0.01


def beside(track: Track, s: float, offset: float, turned: float, speed: float) -> Pose:
    """A car `offset` (m) left of the centre line that points `turned` (rad) to the left of the track."""
    p = track.at(s)
    x, y = p.x - offset * math.sin(p.heading), p.y + offset * math.cos(p.heading)
    return Pose(x, y, p.heading + turned, speed)


def bend_at(track: Track, pose: Pose) -> float:
    """Curvature of the track beside `pose`, 1/m."""
    return float(track.at(track.project(pose.x, pose.y)[0]).curvature)


def offsets(track: Track, path: Path) -> Array:
    return np.array([track.project(float(x), float(y))[1] for x, y in zip(path.x, path.y, strict=True)])


@pytest.mark.parametrize("name", ["road_course", "oval", "tri_oval"])
def test_the_way_of_a_stop_keeps_to_the_road_from_every_place(name):
    """Towards either edge with 3 degrees, as a racing line does, as fast as 10 m/s2 in all bends ahead allow."""
    track = load_track(name)
    ahead = np.arange(0.0, 300.0, 5.0)
    for s in np.arange(0.0, track.length, 40.0):
        bends = np.abs(track.at(s + ahead).curvature)
        speed = min(60.0, math.sqrt((10.0 / np.maximum(bends, 1e-4) + 12.0 * ahead).min()))
        for side in (-1.0, 1.0):
            here = beside(track, float(s), side * 2.5, side * 0.05, speed)
            path = way_along(track, HALF_WIDTH, here, speed * float(track.at(s).curvature), 6.0)
            assert path.s[-1] > speed**2 / 12.0
            assert np.abs(offsets(track, path)).max() < track.width_left.min() - HALF_WIDTH


def test_the_way_of_a_stop_begins_in_the_direction_of_the_car():
    track = load_track("road_course")
    pose = beside(track, 150.0, 2.0, -0.03, 50.0)
    path = way_along(track, HALF_WIDTH, pose, pose.speed * bend_at(track, pose), 6.0)
    nearest = int(np.argmin((path.x - pose.x) ** 2 + (path.y - pose.y) ** 2))
    assert math.hypot(path.x[nearest] - pose.x, path.y[nearest] - pose.y) < 0.01
    ahead = math.atan2(path.y[nearest + 1] - path.y[nearest], path.x[nearest + 1] - path.x[nearest])
    assert abs(math.remainder(ahead - pose.yaw, 2 * math.pi)) < 0.02


def test_the_way_of_a_stop_needs_less_lateral_force_than_the_middle_of_the_road():
    track = load_track("road_course")
    pose = beside(track, 900.0, 0.0, 0.0, 45.0)
    path = way_along(track, HALF_WIDTH, pose, pose.speed * bend_at(track, pose), 6.0)
    speed2 = np.maximum(45.0**2 - 12.0 * path.s, 144.0)
    middle = np.abs(track.at(900.0 + path.s).curvature)
    assert (np.abs(path.curvature) * speed2).max() < 0.8 * (middle * speed2).max()


def test_a_way_from_beside_the_edge_of_a_straight_takes_little_grip_from_the_brakes():
    """0.9 m clear of the edge at 70 m/s: no more than 5 m/s2 lead it to 2.2 m, which 2 s later it has."""
    track = load_track("oval")
    straight = float(track.s[np.argmin(np.convolve(np.abs(track.curvature), np.ones(301), mode="same"))])
    edge = float(track.at(straight).width_left) - HALF_WIDTH
    pose = beside(track, straight, edge - 0.9, 0.0, 70.0)
    path = way_along(track, HALF_WIDTH, pose, 0.0, 12.0, clear=2.2)
    lateral = np.abs(path.curvature)[2:45] * (70.0**2 - 2 * 12.0 * path.s[2:45])
    assert lateral.max() < 5.0
    assert edge - offsets(track, path)[45] > 1.9


def test_a_way_begins_as_the_car_turns():
    """To the left with 14 m/s2 on a straight: its steering is 0.1 s late, and so is the way."""
    track = load_track("oval")
    straight = float(track.s[np.argmin(np.convolve(np.abs(track.curvature), np.ones(301), mode="same"))])
    path = way_along(track, HALF_WIDTH, beside(track, straight, 0.0, 0.0, 70.0), 0.2, 6.0)
    heading = np.unwrap(np.arctan2(np.diff(path.y), np.diff(path.x)))
    assert (heading[2] - heading[1]) * 70.0**2 / 3.0 > 0.7 * 14.0


def test_a_stop_that_no_fixes_guide_keeps_further_from_the_edges():
    """Also where the fixes are lost in the middle of the stop."""
    track = load_track("road_course")
    here, least = beside(track, 900.0, 0.0, 0.0, 45.0), []
    for blind in (False, True):
        stop = stopping(track)
        stop.start(0.0)
        stop.command(motion(45.0), here, emergency=True)
        stop.blind = blind
        stop.command(motion(45.0), here, emergency=True)
        assert stop._path is not None
        least.append(track.width_left.min() - HALF_WIDTH - np.abs(offsets(track, stop._path)).max())
    assert least[1] > least[0] + 0.4


@pytest.mark.parametrize("fixes", [True, False])
def test_a_gateway_without_fixes_for_a_fifth_of_a_second_says_so_to_its_stop(rig, fixes):
    rig.drive = 0.1
    rig.drive_off(6.0)
    assert not rig.gateway._actor.stopping.blind
    rig.car.muted |= set() if fixes else {"novatel_report"}
    rig.run(0.3)
    assert rig.gateway._actor.stopping.blind is not fixes


def test_far_from_the_track_there_is_no_way_along_it():
    track = load_track("oval")
    assert way_along(track, HALF_WIDTH, beside(track, 10.0, 31.0, 0.0, 20.0), 0.0, 6.0) is None


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_car_beside_its_path_steers_towards_it(rig, side):
    stop = following(STRAIGHT, 0.0 * STRAIGHT)
    steer, _ = stop.command(motion(), Pose(0.0, side, 0.0, 40.0), emergency=False)
    assert math.copysign(1.0, steer) == -side


def test_pure_pursuit_is_exact_on_a_circle(rig):
    """delta = atan(L / R) for a rear axle on a circle of radius R (Coulter 1992)."""
    radius, angles = 80.0, np.linspace(0.0, 1.5, 1501)
    x, y = radius * np.sin(angles), radius * (1 - np.cos(angles))
    stop = following(x, y)
    turning = Motion(speed=20.0, yaw_rate=20.0 / radius)
    steer, _ = stop.command(turning, Pose(VEHICLE.lr, 0.0, 0.0, 20.0), emergency=False)
    assert steer == pytest.approx(math.atan(VEHICLE.wheelbase / radius), rel=0.01)


def test_without_a_gyro_pure_pursuit_goes_by_the_course_of_the_centre_of_gravity(rig):
    """Which in a bend is not that of the rear axle: 0.016 rad at 80 m, a twentieth of the steering angle."""
    radius, angles = 80.0, np.linspace(-0.5, 1.5, 2001)
    x, y = radius * np.sin(angles), radius * (1 - np.cos(angles))
    stop = following(x, y)
    turning = Motion(speed=20.0, yaw_rate=0.0, by_gyro=False, late_s=math.inf)
    course = VEHICLE.lr / radius
    steer, _ = stop.command(turning, Pose(VEHICLE.lr, VEHICLE.lr * course, course, 20.0), emergency=False)
    assert steer == pytest.approx(math.atan(VEHICLE.wheelbase / radius), rel=0.02)


@pytest.mark.parametrize("by_gyro", [True, False])
def test_without_a_gyro_no_more_is_steered_than_tyres_could_hold(rig, by_gyro):
    """Half a radian off its way at 60 m/s: what would be asked for is twice the force of racing tyres."""
    stop = following(STRAIGHT, 0.0 * STRAIGHT)
    lost = Motion(speed=60.0, by_gyro=by_gyro, late_s=math.inf)
    steer, _ = stop.command(lost, Pose(0.0, 0.0, 0.5, 60.0), emergency=False)
    most = 1.5 * StopConfig().grip(VEHICLE, 60.0)
    assert (abs(math.tan(steer)) <= 1.001 * VEHICLE.wheelbase * most / 60.0**2) is not by_gyro


def largest_yaw_rates(rig: Rig, **source: bool) -> tuple[float, float]:
    """In the first and in the fourth second of a stop on a straight at 70 m/s, rad/s.

    A linear bicycle whose rear axle is 30 % weaker than the front one for its lever, beyond its critical speed;
    steering acts after 0.04 s and with 3 Hz.
    """
    speed, dt, front, rear = 70.0, 0.01, 130e3, 125e3
    way = np.linspace(-10.0, 600.0, 300)
    stop = following(way, 0.0 * way)
    x, y, yaw, vy, rate, angle, sent, rates = 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, [0.0] * 4, []
    for _ in range(400):
        pose = Pose(x, y, yaw, speed, vy / speed)
        sent.append(stop.command(Motion(speed, rate, **source), pose, emergency=True)[0])
        angle += dt * 2 * math.pi * 3.0 * (sent[-5] - angle)
        across_f = front * (angle - (vy + VEHICLE.lf * rate) / speed)
        across_r = -rear * (vy - VEHICLE.lr * rate) / speed
        vy += dt * ((across_f + across_r) / VEHICLE.mass - speed * rate)
        rate += dt * (across_f * VEHICLE.lf - across_r * VEHICLE.lr) / VEHICLE.yaw_inertia
        x, y, yaw = x + dt * speed, y + dt * (speed * yaw + vy), yaw + dt * rate
        rates.append(abs(rate))
    return max(rates[:100]), max(rates[300:])


def test_a_stop_steadies_a_car_that_oversteers(rig):
    first, last = largest_yaw_rates(rig)
    assert last < 0.5 * first
    first, last = largest_yaw_rates(rig, by_gyro=False)
    assert last < 0.5 * first, "the wheels tell how the car turns"
    first, last = largest_yaw_rates(rig, by_gyro=False, late_s=math.inf)
    assert last > first, "the car weaves where nothing but its place steadies it"


def furthest_off(kick: float, known: bool) -> tuple[float, float]:
    """How far a car is off a bend of 260 m at 60 m/s at most, m, and its side slip, rad, that a `kick` (rad/s) meets
    after 1.5 s: its rear axle bears 16 m/s2, its front one 20, and it needs 14; steering acts as declared."""
    radius, speed, actuators, turns = 260.0, 60.0, CAR.actuators, np.linspace(-0.1, 2.0, 1500)
    stop = following(radius * np.sin(turns), radius * (1.0 - np.cos(turns)))
    car = TurningCar(VEHICLE, speed, 20.0, weaker=0.8, yaw_rate=speed / radius)
    front, rear = (
        Axle(grip, grip * VEHICLE.mass * arm / (VEHICLE.wheelbase * stiff), 0.0)
        for grip, arm, stiff in ((20.0, VEHICLE.lr, FRONT), (16.0, VEHICLE.lf, REAR))
    )
    x, y, yaw, angle, off, slip, sent = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, [0.0] * 20
    for i in range(500):
        car.yaw_rate += kick if i == 150 else 0.0
        going, pose = car.side_speed / speed, Pose(x, y, yaw, speed, math.atan(car.side_speed / speed))
        axles = Axles(VEHICLE, front, rear, speed, car.side_speed, car.yaw_rate, 0.0, 0.0)
        ahead = axles.onward(sent[-round(100 * actuators.steering_late) :]) if known else None
        sent.append(stop.command(Motion(speed, car.yaw_rate, speed * car.yaw_rate), pose, False, ahead)[0])
        due = sent[-1 - round(100 * actuators.steering_delay)]
        angle += 0.01 * math.tau * actuators.steering_bandwidth * (due - angle)
        car.turn(angle)
        x += 0.01 * speed * (math.cos(yaw) - going * math.sin(yaw))
        y += 0.01 * speed * (math.sin(yaw) + going * math.cos(yaw))
        yaw += 0.01 * car.yaw_rate
        off, slip = max(off, abs(math.hypot(x, y - radius) - radius)), max(slip, abs(going))
    return off, slip


@pytest.mark.parametrize("kick", [0.0, 0.3])
def test_a_car_that_is_weak_behind_is_held_near_its_limit(rig, kick):
    off, slip = furthest_off(kick, known=True)
    assert off < 2.5
    assert slip < 0.2
    assert furthest_off(kick, known=False)[1] > 1.0, "steered by path and yaw rate alone it spins"


def test_without_a_path_the_steering_is_held(rig):
    stop = stopping()
    stop.start(0.07)
    assert stop.command(motion(), HERE, emergency=True)[0] == 0.07


@pytest.mark.parametrize(("emergency", "deceleration"), [(False, 6.0), (True, 12.0)])
def test_braking_is_as_configured_on_a_straight(rig, emergency, deceleration):
    _, drive = stopping().command(motion(), HERE, emergency)
    assert drive * 50_000.0 / VEHICLE.mass == pytest.approx(-deceleration)


def test_braking_leaves_the_grip_a_bend_needs(rig):
    _, straight = stopping().command(motion(20.0, ay=0.0), HERE, emergency=True)
    _, bend = stopping().command(motion(20.0, ay=11.0), HERE, emergency=True)
    _, beyond = stopping().command(motion(20.0, ay=40.0), HERE, emergency=True)
    assert straight < bend < beyond < 0


def on_a_circle(rig: Rig) -> tuple[Stopping, Pose]:
    """A stop on a way that bends with 80 m of radius, from its beginning."""
    radius, angles = 80.0, np.linspace(0.0, 1.5, 1501)
    x, y = radius * np.sin(angles), radius * (1 - np.cos(angles))
    stop = following(x, y)
    return stop, Pose(8.0, 0.4, 0.1, 30.0)


def test_front_tyres_that_slide_under_the_brakes_get_the_grip_their_bend_needs(rig):
    """The car has hardly any lateral force, and its way needs 11 m/s2: brakes do not take what steering lacks."""
    stop, pose = on_a_circle(rig)
    _, sliding = stop.command(motion(30.0, ay=2.0), pose, emergency=True)
    _, holding = stop.command(motion(30.0, ay=30.0**2 / 80.0), pose, emergency=True)
    assert sliding == pytest.approx(holding, rel=0.05)


def test_a_car_beside_its_way_gets_the_grip_that_leads_it_back(rig):
    drives = []
    for pose in (Pose(50.0, 0.0, 0.0, 70.0), Pose(50.0, 1.2, 0.03, 70.0)):
        stop = following(STRAIGHT, 0.0 * STRAIGHT)
        drives.append(stop.command(motion(70.0), pose, emergency=True)[1])
    on_it, beside_it = drives
    assert on_it < 1.5 * beside_it < 0.0


def test_a_bend_that_is_too_fast_gets_its_brakes_all_the_same(rig):
    stop, pose = on_a_circle(rig)
    drives = [stop.command(motion(45.0), pose._replace(speed=45.0, yaw=yaw), emergency=True)[1] for yaw in (0.1, 0.0)]
    assert drives[1] == pytest.approx(drives[0], rel=0.05)


def test_a_car_that_no_longer_steers_is_braked_with_all_its_grip(rig):
    stop, pose = on_a_circle(rig)
    steering = [stop.command(motion(30.0, ay=2.0), pose, emergency=True, steers=steers)[1] for steers in (True, False)]
    assert steering[1] < 1.2 * steering[0]


def test_a_stop_without_brakes_takes_a_way_on_which_a_car_that_rolls_out_needs_less_lateral_force():
    """From the straight before a bend, at 45 m/s."""
    track = load_track("road_course")
    bend = float(track.s[np.argmax(np.abs(track.curvature))])
    here, forces = beside(track, bend - 80.0, 2.0, 0.0, 45.0), []
    for brakes in (True, False):
        stop = stopping(track)
        stop.start(0.0)
        stop.command(motion(45.0), here, True, brakes=brakes)
        assert stop._path is not None
        speed2 = np.maximum(45.0**2 - 2 * 2.0 * stop._path.s, 0.0)
        near = stop._path.s < 160.0
        forces.append(float((speed2 * np.abs(stop._path.curvature))[near].max()))
    assert forces[1] < 0.97 * forces[0]


def test_a_stop_at_speed_steers_by_where_the_car_goes_not_by_where_it_points(rig):
    """Its nose points 0.04 rad to the inside of the bend it drives, as its tyres need: it turns as it should."""
    speed, rate = 30.0, 30.0 / 80.0
    tyres = Axle(40.0, 0.04 / math.atanh(speed * rate / 40.0), 0.0)
    side = VEHICLE.lr * rate - 0.04 * speed
    axles = Axles(VEHICLE, tyres, tyres, speed, side, rate, 0.0, 0.0)
    angle, (stop, pose) = VEHICLE.wheelbase / 80.0, on_a_circle(rig)
    axles = axles.onward([angle] * round(100 * CAR.actuators.steering_late))
    turning = Motion(speed, rate, speed * rate, slip=side / speed)
    steer, _ = stop.command(turning, pose._replace(yaw=pose.yaw + 0.04, slip=side / speed), False, axles)
    assert steer == pytest.approx(angle, abs=6e-3)


def test_a_stop_steers_more_with_a_car_that_understeers(rig):
    stop, pose = on_a_circle(rig)
    steady = Motion(30.0, 30.0 / 80.0, 30.0**2 / 80.0)
    plain, pushing = (stop.command(steady._replace(understeer=k), pose, emergency=False)[0] for k in (0.0, 1e-3))
    assert pushing > plain + 0.3 * 1e-3 * steady.ay
