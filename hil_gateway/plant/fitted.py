"""The simulated car of another platform.

The plant keeps its own car, the AV-24, with numbers that no data sheet has. Of another platform each of them is scaled
by the ratio of what that platform declares to what the AV-24 does: it differs from its data sheet as much as the AV-24
differs from its own. Of the AV-24 nothing changes.
"""

from __future__ import annotations

from dataclasses import replace

from hil_gateway.car.car import Car, load_car
from hil_gateway.plant.physics.parameters import ENGINE_SPEEDS, CarParameters, PlantParameters, SensorParameters

REFERENCE = "av24"


def fitted(parameters: PlantParameters, platform: Car) -> PlantParameters:
    """`parameters` of the plant's own car, for the car of a platform."""
    own = load_car(REFERENCE)
    if platform.sha256 == own.sha256:
        return parameters
    acts, own_acts = platform.actuators, own.actuators
    return replace(
        parameters,
        car=_car(parameters.car, platform, own),
        sensors=_sensors(parameters.sensors, platform, own),
        gears=platform.powertrain.gears,
        final_drive=platform.powertrain.final_drive,
        steer_delay=parameters.steer_delay * _ratio(acts.steering_delay, own_acts.steering_delay),
        pressure_max=parameters.pressure_max
        * platform.powertrain.brake_pressure_max
        / own.powertrain.brake_pressure_max,
        brake_delay=parameters.brake_delay * _ratio(acts.brake_delay, own_acts.brake_delay),
    )


def _ratio(value: float, own: float) -> float:
    return value / own if own else 1.0


def _car(car: CarParameters, platform: Car, own: Car) -> CarParameters:
    v, w, train, own_train = platform.vehicle, own.vehicle, platform.powertrain, own.powertrain
    lift, own_lift = (x.lift_area_front + x.lift_area_rear for x in (v, w))
    front, own_front = _ratio(v.lift_area_front, lift), _ratio(w.lift_area_front, own_lift)
    brakes = train.brake_force_per_pa * v.wheel_radius / (own_train.brake_force_per_pa * w.wheel_radius)
    share = train.brake_share_front / own_train.brake_share_front
    revs = train.engine_rpm[-1] / own_train.engine_rpm[-1]
    torque = tuple(
        t * train.engine_torque_at(revs * at) / own_train.engine_torque_at(at)
        for t, at in zip(car.engine_torque, ENGINE_SPEEDS, strict=True)
    )
    tyres, own_tyres = platform.tyres, own.tyres
    actuators, own_actuators = platform.actuators, own.actuators
    steer_rate = actuators.steering_rate / v.steering_ratio / (own_actuators.steering_rate / w.steering_ratio)
    return replace(
        car,
        mass=car.mass * v.mass / w.mass,
        yaw_inertia=car.yaw_inertia * v.yaw_inertia / w.yaw_inertia,
        lf=car.lf * v.lf / w.lf,
        lr=car.lr * v.lr / w.lr,
        cg_height=car.cg_height * _ratio(v.cg_height, w.cg_height),
        track_front=car.track_front * v.track_front / w.track_front,
        track_rear=car.track_rear * v.track_rear / w.track_rear,
        wheel_radius=car.wheel_radius * v.wheel_radius / w.wheel_radius,
        drag=car.drag * _ratio(v.drag_area, w.drag_area),
        downforce=car.downforce * _ratio(lift, own_lift),
        downforce_share_front=min(car.downforce_share_front * _ratio(front, own_front), 1.0),
        bf=car.bf * tyres.bf / own_tyres.bf,
        br=car.br * tyres.br / own_tyres.br,
        df=car.df * tyres.df / own_tyres.df,
        dr=car.dr * tyres.dr / own_tyres.dr,
        engine_torque=torque,
        engine_speed_scale=car.engine_speed_scale * revs,
        engine_clutch=car.engine_clutch * train.clutch_rpm / own_train.clutch_rpm,
        engine_drag=car.engine_drag * _ratio(train.drag_torque, own_train.drag_torque),
        brake_gain_front=car.brake_gain_front * brakes * share,
        brake_gain_rear=car.brake_gain_rear * brakes * (2.0 - share),
        steer_bandwidth=car.steer_bandwidth * actuators.steering_bandwidth / own_actuators.steering_bandwidth,
        steer_rate=car.steer_rate * steer_rate,
        steer_max=car.steer_max * actuators.steering_range / own_actuators.steering_range,
        brake_bandwidth=car.brake_bandwidth * actuators.brake_bandwidth / own_actuators.brake_bandwidth,
        brake_rate=car.brake_rate * actuators.brake_rise / own_actuators.brake_rise,
    )


def _sensors(sensors: SensorParameters, platform: Car, own: Car) -> SensorParameters:
    (imu, *_), (own_imu, *_) = platform.imus.values(), own.imus.values()
    (receiver, *_), (own_receiver, *_) = platform.receivers.values(), own.receivers.values()
    reports, own_reports = platform.sensors, own.sensors
    steering, own_steering = (car.sensors.steering_noise / car.vehicle.steering_ratio for car in (platform, own))
    return replace(
        sensors,
        acceleration_noise=sensors.acceleration_noise * imu.acceleration_noise / own_imu.acceleration_noise,
        yaw_rate_noise=sensors.yaw_rate_noise * imu.rate_noise / own_imu.rate_noise,
        speed_noise=sensors.speed_noise * reports.wheel_speed_noise / own_reports.wheel_speed_noise,
        position_noise=sensors.position_noise * receiver.noise / own_receiver.noise,
        steer_noise=sensors.steer_noise * steering / own_steering,
    )
