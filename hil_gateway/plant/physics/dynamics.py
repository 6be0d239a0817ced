"""The physics of the car as one ordinary differential equation, dx/dt = f(x, u, p), and its Runge-Kutta step.

Symbolic (CasADi), so that one text serves the compiled step, the interpreted one and the tests; parameters are
an input, so that no effect needs a compiler.
"""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import casadi as ca

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.plant.physics import chassis, driveline, tyre
from hil_gateway.plant.physics.parameters import AV24, CarParameters
from hil_gateway.process.arrays import Expr

STATES = (
    "x", "y", "yaw", "vx", "vy", "yaw_rate",
    "spin_fl", "spin_fr", "spin_rl", "spin_rr",
    "slip_x_fl", "slip_x_fr", "slip_x_rl", "slip_x_rr",
    "slip_y_fl", "slip_y_fr", "slip_y_rl", "slip_y_rr",
    "load_ax", "load_ay",
    "steer", "throttle", "brake_front", "brake_rear",
)  # fmt: skip
"""position m, velocity m/s, wheel spin rad/s, slips 1, lagged specific force m/s2, actuators (rad, 0..1, Pa)"""

INPUTS = (
    "steer_command", "throttle_command", "brake_front_command", "brake_rear_command",
    "ratio", "engine_running",
    "late_steer", "late_throttle", "late_brake_front", "late_brake_rear",
    "gravity_x", "gravity_y", "gravity_z", "grip",
    "flat_fl", "flat_fr", "flat_rl", "flat_rr", "gust", "brake_loss", "push",
)  # fmt: skip
"""delayed commands, engine over axle speed, 0 or 1, delayed actuators; gravity in body axes m/s2, factor on friction,
per wheel 0 (sound) to 1 (tyre flat), side force on the body N, share of the brakes' torque that is missing, force
forward on the body N"""

FLAT_GRIP_LOSS = 0.6
"""share of its friction a tyre without air loses, assumed: the carcass folds under the rim and carries on its edge"""
FLAT_ROLLING = 0.06
"""rolling resistance of a flat tyre over its load, assumed: several times a sound tyre's 0.012"""

OUTPUTS = (
    "ax", "ay", "az", "yaw_acc", "engine_speed", "axle_torque",
    "load_fl", "load_fr", "load_rl", "load_rr",
    "force_x_front", "force_x_rear", "force_y_front", "force_y_rear", "power_loss",
    "use_front", "use_rear", "slip_front", "slip_rear",
)  # fmt: skip
"""specific force m/s2, rad/s2, rad/s, N m, N; lateral and longitudinal axle forces in wheel axes; W lost in tyres,
air, brakes and rolling; per axle its force over the most its tyres can give under their loads, and its combined slip
over that of the peak (beyond 1 the axle slides)"""


def _bind(names: tuple[str, ...], vector: Any) -> Any:
    return SimpleNamespace(**{name: vector[i] for i, name in enumerate(names)})


def _effective_inputs(s: Any, u: Any, p: Any) -> tuple[Expr, Expr, Expr, Expr]:
    """What really acts on the car: road-wheel angle, throttle, brake pressures."""
    reported = s.steer + p.steer_late * (u.late_steer - s.steer)

    def late(now: Expr, before: Expr) -> Expr:
        return now + p.drive_late * (before - now)

    return (
        p.steer_scale * reported + p.steer_offset,
        late(s.throttle, u.late_throttle),
        (1.0 - u.brake_loss) * late(s.brake_front, u.late_brake_front),
        (1.0 - u.brake_loss) * late(s.brake_rear, u.late_brake_rear),
    )


def _tyre_forces(s: Any, u: Any, p: Any, steers: list[Expr], loads: list[Expr]) -> Any:
    """Per wheel: force along and across, slip rates, velocity along and across, slip powers."""
    nominal = chassis.static_loads(p, GRAVITY)
    xs, ys = chassis.wheel_positions(p)
    flats = (u.flat_fl, u.flat_fr, u.flat_rl, u.flat_rr)
    out = SimpleNamespace(along=[], across=[], rate_x=[], rate_y=[], contacts=[], slips=[], power=0.0)
    for i, name in enumerate(("fl", "fr", "rl", "rr")):
        front = i in chassis.FRONT
        grip = u.grip * (p.grip_front if front else p.grip_rear) * (1.0 - FLAT_GRIP_LOSS * flats[i])
        grip = grip * tyre.friction_factor(loads[i], nominal[i], p.load_sensitivity)
        B, C, D, E = (p.bf, p.cf, p.df, p.ef) if front else (p.br, p.cr, p.dr, p.er)
        contact = tyre.Tyre(
            load=loads[i],
            along=tyre.Curve(p.bx, p.cx, p.dx * grip, p.ex),
            across=tyre.Curve(B, C, D * grip, E),
            combined=p.combined_slip,
            saturation=p.saturation,
            stiffness=nominal[i] * p.bx * p.cx * p.dx,
        )
        rim = getattr(s, f"spin_{name}") * p.wheel_radius
        velocity = chassis.wheel_velocity(s.vx, s.vy, s.yaw_rate, x=xs[i], y=ys[i], steer=steers[i])
        relaxed = getattr(s, f"slip_x_{name}"), getattr(s, f"slip_y_{name}")
        rate_x, rate_y = tyre.slip_rates(velocity, rim, relaxed, (p.relaxation_x, p.relaxation_y), contact)
        slip = tyre.damped(velocity, rim, relaxed)
        fx, fy = tyre.forces(slip, contact)
        fy = fy * (1.0 + p.turn_asymmetry * ca.tanh(slip[1] / 0.01))
        out.along.append(fx)
        out.across.append(fy)
        out.rate_x.append(rate_x)
        out.rate_y.append(rate_y)
        out.contacts.append(contact)
        out.slips.append(slip)
        out.power += fx * (rim - velocity[0]) - fy * velocity[1]
    return out


def _actuator_rates(s: Any, u: Any, p: Any) -> list[Expr]:
    """First-order lags with rate limits: steering, throttle, both brake circuits."""

    def towards(value: Expr, command: Expr, bandwidth: Expr, limit: Expr) -> Expr:
        return ca.fmax(-limit, ca.fmin(limit, bandwidth * (command - value)))

    wanted = ca.fmax(-p.steer_max, ca.fmin(p.steer_max, u.steer_command))
    return [
        towards(s.steer, wanted, p.steer_bandwidth, p.steer_rate),
        towards(s.throttle, u.throttle_command, p.throttle_bandwidth, 100.0),
        towards(s.brake_front, u.brake_front_command, p.brake_bandwidth, p.brake_rate),
        towards(s.brake_rear, u.brake_rear_command, p.brake_bandwidth, p.brake_rate),
    ]


def _use(tyres: Any, wheels: tuple[int, ...]) -> tuple[Expr, Expr]:
    """Of an axle: its force over the most its tyres can give, and its combined slip over the peak's, weighted by load.

    Weighted, because an inner wheel with little load may slip far without the axle losing anything.
    """
    contacts = [tyres.contacts[i] for i in wheels]
    most_x, most_y = (sum(c.load * getattr(c, way).D for c in contacts) for way in ("along", "across"))
    share_x, share_y = sum(tyres.along[i] for i in wheels) / most_x, sum(tyres.across[i] for i in wheels) / most_y
    slip = sum(c.load * tyre.slip_over_peak(tyres.slips[i], c) for i, c in zip(wheels, contacts, strict=True))
    return ca.sqrt(share_x**2 + share_y**2), slip / sum(c.load for c in contacts)


def _wheels(s: Any, u: Any, p: Any, *, throttle: Expr, pressures: tuple[Expr, Expr], along: list[Expr],
            loads: list[Expr]) -> Any:  # fmt: skip
    """Spin rates of the wheels, engine speed, axle torque and the power lost in brakes, flat tyres and differential."""
    spins = [s.spin_fl, s.spin_fr, s.spin_rl, s.spin_rr]
    flats = (u.flat_fl, u.flat_fr, u.flat_rl, u.flat_rr)
    axle = 0.5 * (s.spin_rl + s.spin_rr)
    speed = driveline.engine_speed(p, axle, u.ratio)
    torque = driveline.axle_torque(p, throttle, speed, u.ratio, u.engine_running)
    driven = [0.0, 0.0, *driveline.differential(p, torque, s.spin_rl, s.spin_rr)]
    rolling = [-FLAT_ROLLING * p.wheel_radius * flats[i] * loads[i] * ca.tanh(spins[i]) for i in range(4)]
    inertia = [p.wheel_inertia, p.wheel_inertia] + 2 * [p.wheel_inertia + 0.5 * p.engine_inertia * u.ratio**2]
    others = [driven[i] + rolling[i] - p.wheel_radius * along[i] for i in range(4)]
    brakes = driveline.brake_torques(p, *pressures, speeds=spins, others=others, inertia=inertia)
    rates = [(others[i] + brakes[i]) / inertia[i] for i in range(4)]
    slipping = sum(driven[i] * (axle - spins[i]) for i in (2, 3))
    lost = slipping - sum((b + r) * w for b, r, w in zip(brakes, rolling, spins, strict=True))
    return SimpleNamespace(rates=rates, engine_speed=speed, torque=torque, lost=lost)


def _body(s: Any, u: Any, p: Any, *, steers: list[Expr], tyres: Any, air: tuple[Expr, Expr]) -> Any:
    """Specific force, yaw acceleration, rates of pose and velocity, and the power lost to air, rolling and damping."""
    drag, side = air
    rolling = -p.rolling_resistance * ca.tanh(s.vx)
    xs, ys = chassis.wheel_positions(p)
    wheels = [chassis.to_body(tyres.along[i], tyres.across[i], steers[i]) for i in range(4)]
    ax = (sum(w[0] for w in wheels) + drag + rolling + u.push) / p.mass
    ay = (sum(w[1] for w in wheels) + side + u.gust) / p.mass
    moment = sum(xs[i] * wheels[i][1] - ys[i] * wheels[i][0] for i in range(4)) - p.yaw_damping * s.yaw_rate
    yaw_acc = moment / p.yaw_inertia
    rates = [
        s.vx * ca.cos(s.yaw) - s.vy * ca.sin(s.yaw),
        s.vx * ca.sin(s.yaw) + s.vy * ca.cos(s.yaw),
        s.yaw_rate,
        ax + s.vy * s.yaw_rate + u.gravity_x,
        ay - s.vx * s.yaw_rate + u.gravity_y,
        yaw_acc,
    ]
    lost = p.yaw_damping * s.yaw_rate**2 - (drag + rolling + u.push) * s.vx - (side + u.gust) * s.vy
    return SimpleNamespace(ax=ax, ay=ay, yaw_acc=yaw_acc, rates=rates, lost=lost)


def _rates(x: Expr, u: Expr, p: Any) -> tuple[Expr, Expr]:
    """dx/dt and outputs."""
    s, u = _bind(STATES, x), _bind(INPUTS, u)
    steer, throttle, *pressures = _effective_inputs(s, u, p)
    steers: list[Expr] = [steer, steer, 0.0, 0.0]
    drag, side, downforce = chassis.air_forces(p, s.vx, s.vy, s.yaw)
    loads = chassis.wheel_loads(p, u.gravity_z, s.load_ax, s.load_ay, downforce)
    tyres = _tyre_forces(s, u, p, steers, loads)
    wheels = _wheels(s, u, p, throttle=throttle, pressures=(pressures[0], pressures[1]), along=tyres.along, loads=loads)
    body = _body(s, u, p, steers=steers, tyres=tyres, air=(drag, side))
    load_lags = [(body.ax - s.load_ax) / p.load_lag, (body.ay - s.load_ay) / p.load_lag]
    rates = [*body.rates, *wheels.rates, *tyres.rate_x, *tyres.rate_y, *load_lags, *_actuator_rates(s, u, p)]
    outputs = [
        body.ax, body.ay, (sum(loads) - downforce) / p.mass, body.yaw_acc, wheels.engine_speed, wheels.torque, *loads,
        tyres.along[0] + tyres.along[1], tyres.along[2] + tyres.along[3],
        tyres.across[0] + tyres.across[1], tyres.across[2] + tyres.across[3],
        tyres.power + body.lost + wheels.lost,
        *(value for pair in zip(_use(tyres, chassis.FRONT), _use(tyres, chassis.REAR), strict=True) for value in pair),
    ]  # fmt: skip
    return ca.vertcat(*rates), ca.vertcat(*outputs)


def _symbols() -> tuple[Expr, Expr, Expr, Any]:
    vector = ca.SX.sym("p", len(AV24.car.vector()))
    return ca.SX.sym("x", len(STATES)), ca.SX.sym("u", len(INPUTS)), vector, AV24.car.symbols(vector)


@cache
def rates_function() -> ca.Function:
    """(x, u, p) -> (dx/dt, outputs)."""
    x, u, vector, p = _symbols()
    return ca.Function("plant_rates", [x, u, vector], list(_rates(x, u, p)), ["x", "u", "p"], ["rates", "outputs"])


@cache
def step_function() -> ca.Function:
    """(x, u, p, h) -> (x after h seconds, outputs at the start): classical fourth-order Runge-Kutta.

    Outputs are those of the first stage: they cost nothing and belong to the time of the state given.
    """
    x, u, vector, _ = _symbols()
    h = ca.SX.sym("h")
    f = rates_function()
    k1, outputs = f(x, u, vector)
    k2, _ = f(x + 0.5 * h * k1, u, vector)
    k3, _ = f(x + 0.5 * h * k2, u, vector)
    k4, _ = f(x + h * k3, u, vector)
    after = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    after, outputs = ca.cse([after, outputs])  # what depends on parameters alone is worked out once, not 16 times
    return ca.Function("plant_step", [x, u, vector, h], [after, outputs], ["x", "u", "p", "h"], ["after", "outputs"])


__all__ = ["INPUTS", "OUTPUTS", "STATES", "CarParameters", "rates_function", "step_function"]
